/** How the shader reads the texels of `texels.ts`. */

import { LN_SCALE_STEPS, MIN_LN_SCALE } from "./pack.js";

export const READ_CORE = `
  vec4 evogsRotation(uint low, uint high) {
    vec3 parts = (vec3(float(low & 0x7fffu), float((low >> 15u) & 0x7fffu), float(high & 0x7fffu)) - 16383.5)
      * (1.41421356237 / 32767.0);
    float rest = sqrt(max(0.0, 1.0 - dot(parts, parts)));
    uint largest = low >> 30u;
    // The components are w, x, y, z; a quaternion of the shader is x, y, z, w.
    if (largest == 0u) return vec4(parts, rest);
    if (largest == 1u) return vec4(rest, parts.yz, parts.x);
    if (largest == 2u) return vec4(parts.y, rest, parts.z, parts.x);
    return vec4(parts.yz, rest, parts.x);
  }

  void evogsCore(
    usampler2D core, int width, int index,
    out vec3 center, out vec3 scales, out vec4 quaternion, out vec4 rgba
  ) {
    ivec2 at = ivec2(2 * (index % width), index / width);
    uvec4 a = texelFetch(core, at, 0);
    uvec4 b = texelFetch(core, at + ivec2(1, 0), 0);
    center = uintBitsToFloat(a.xyz);
    vec3 ln = vec3(float(a.w >> 16u), float(b.x & 0xffffu), float(b.x >> 16u));
    scales = exp(ln / ${LN_SCALE_STEPS}.0 + ${MIN_LN_SCALE}.0);
    quaternion = evogsRotation(b.y, b.z & 0xffffu);
    rgba = vec4(unpackHalf2x16(b.z).y, unpackHalf2x16(b.w), unpackHalf2x16(a.w).x);
  }
`;

/**
 * A splat between two states, as Annex D of the spec has it, but for second children: they grow from their
 * ancestor's state with opacity 0, since two copies of it are denser than one, whatever their opacity.
 * `part` is that of the later state in all but opacity, and `from` is the place of the earlier one.
 */
export const READ_BETWEEN = `
  void evogsBetween(
    usampler2D before, usampler2D sources, int width, int index, float time,
    inout vec3 center, inout vec3 scales, inout vec4 quaternion, inout vec4 rgba,
    out float part, out int from
  ) {
    uint source = texelFetch(sources, ivec2(index % width, index / width), 0).x;
    from = source == 0u ? index : int(source) - 1;
    vec3 center0, scales0;
    vec4 quaternion0, rgba0;
    evogsCore(before, width, from, center0, scales0, quaternion0, rgba0);
    part = rgba0.a == 0.0 ? 1.0 : rgba.a == 0.0 ? 0.0 : time;
    float alpha = mix(source == 0u ? rgba0.a : 0.0, rgba.a, time);
    center = mix(center0, center, part);
    if (part > 0.0 && part < 1.0) scales = exp(mix(log(scales0), log(scales), part));
    else if (part == 0.0) scales = scales0;
    if (dot(quaternion0, quaternion) < 0.0) quaternion0 = -quaternion0;
    quaternion = normalize(mix(quaternion0, quaternion, part));
    rgba = vec4(mix(rgba0.rgb, rgba.rgb, part), alpha);
  }
`;

/** SH of bands 1 to 3, of the direction from the eye. */
export const READ_BANDS = [
  `
  vec3 evogsBand1(usampler2D band, int width, int index, vec3 d) {
    ivec2 at = ivec2(2 * (index % width), index / width);
    uvec4 a = texelFetch(band, at, 0);
    uint last = texelFetch(band, at + ivec2(1, 0), 0).x;
    vec2 p0 = unpackHalf2x16(a.x), p1 = unpackHalf2x16(a.y), p2 = unpackHalf2x16(a.z), p3 = unpackHalf2x16(a.w);
    vec2 p4 = unpackHalf2x16(last);
    return 0.4886025119029199
      * (-d.y * vec3(p0, p1.x) + d.z * vec3(p1.y, p2) - d.x * vec3(p3, p4.x));
  }
`,
  `
  vec3 evogsBand2(usampler2D band, int width, int index, vec3 d) {
    ivec2 at = ivec2(2 * (index % width), index / width);
    uvec4 a = texelFetch(band, at, 0);
    uvec4 b = texelFetch(band, at + ivec2(1, 0), 0);
    vec2 p0 = unpackHalf2x16(a.x), p1 = unpackHalf2x16(a.y), p2 = unpackHalf2x16(a.z), p3 = unpackHalf2x16(a.w);
    vec2 p4 = unpackHalf2x16(b.x), p5 = unpackHalf2x16(b.y), p6 = unpackHalf2x16(b.z), p7 = unpackHalf2x16(b.w);
    return 1.0925484305920792 * (d.x * d.y * vec3(p0, p1.x) - d.y * d.z * vec3(p1.y, p2))
      + 0.31539156525252005 * (2.0 * d.z * d.z - d.x * d.x - d.y * d.y) * vec3(p3, p4.x)
      - 1.0925484305920792 * d.x * d.z * vec3(p4.y, p5)
      + 0.5462742152960396 * (d.x * d.x - d.y * d.y) * vec3(p6, p7.x);
  }
`,
  `
  vec3 evogsBand3(usampler2D band, int width, int index, vec3 d) {
    ivec2 at = ivec2(3 * (index % width), index / width);
    uvec4 a = texelFetch(band, at, 0);
    uvec4 b = texelFetch(band, at + ivec2(1, 0), 0);
    uvec4 c = texelFetch(band, at + ivec2(2, 0), 0);
    vec2 p0 = unpackHalf2x16(a.x), p1 = unpackHalf2x16(a.y), p2 = unpackHalf2x16(a.z), p3 = unpackHalf2x16(a.w);
    vec2 p4 = unpackHalf2x16(b.x), p5 = unpackHalf2x16(b.y), p6 = unpackHalf2x16(b.z), p7 = unpackHalf2x16(b.w);
    vec2 p8 = unpackHalf2x16(c.x), p9 = unpackHalf2x16(c.y), p10 = unpackHalf2x16(c.z);
    float xx = d.x * d.x, yy = d.y * d.y, zz = d.z * d.z;
    return -0.5900435899266435 * d.y * (3.0 * xx - yy) * vec3(p0, p1.x)
      + 2.890611442640554 * d.x * d.y * d.z * vec3(p1.y, p2)
      - 0.4570457994644658 * d.y * (4.0 * zz - xx - yy) * vec3(p3, p4.x)
      + 0.3731763325901154 * d.z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * vec3(p4.y, p5)
      - 0.4570457994644658 * d.x * (4.0 * zz - xx - yy) * vec3(p6, p7.x)
      + 1.445305721320277 * d.z * (xx - yy) * vec3(p7.y, p8)
      - 0.5900435899266435 * d.x * (xx - 3.0 * yy) * vec3(p9, p10.x);
  }
`,
];
