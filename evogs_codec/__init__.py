"""EvoGS: one progressive stream for every quality of a 3D Gaussian Splatting scene.

data = encode_scene(read_ply("scene.ply"))
splats = decode_leaves(data)

docs/api.md shows the rest. What is not named here may change without notice.

A name is imported when it is first asked for: who decodes loads no encoder.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evogs_codec.common.progress import Progress as Progress
    from evogs_codec.common.version import __version__ as __version__
    from evogs_codec.decoding.byte_ranges import byte_ranges as byte_ranges
    from evogs_codec.decoding.cut import Cut as Cut
    from evogs_codec.decoding.decode import Decoded as Decoded
    from evogs_codec.decoding.decode import decode as decode
    from evogs_codec.decoding.decode import decode_leaves as decode_leaves
    from evogs_codec.decoding.decode import decode_prefix as decode_prefix
    from evogs_codec.decoding.progressive import Decoder as Decoder
    from evogs_codec.decoding.progressive import StepReady as StepReady
    from evogs_codec.editing.extract import choose_cut as choose_cut
    from evogs_codec.editing.extract import extract as extract
    from evogs_codec.editing.level_psnr import LevelPsnr as LevelPsnr
    from evogs_codec.editing.level_psnr import level_psnr as level_psnr
    from evogs_codec.encoding.arrange import leaf_order as leaf_order
    from evogs_codec.encoding.encode import encode as encode
    from evogs_codec.encoding.grids import AccuracyWarning as AccuracyWarning
    from evogs_codec.encoding.grids import NotRepresentableError as NotRepresentableError
    from evogs_codec.encoding.out_of_reach import TargetMissedError as TargetMissedError
    from evogs_codec.encoding.pictures import Pictures as Pictures
    from evogs_codec.encoding.settings import PRESETS as PRESETS
    from evogs_codec.encoding.settings import FixedSteps as FixedSteps
    from evogs_codec.encoding.settings import NearLossless as NearLossless
    from evogs_codec.encoding.settings import RangeBits as RangeBits
    from evogs_codec.encoding.settings import Settings as Settings
    from evogs_codec.encoding.settings import StepTable as StepTable
    from evogs_codec.encoding.targets import TargetEncoder as TargetEncoder
    from evogs_codec.errors import EvogsError as EvogsError
    from evogs_codec.errors import Fault as Fault
    from evogs_codec.errors import InputError as InputError
    from evogs_codec.errors import StreamError as StreamError
    from evogs_codec.format.directory import Directory as Directory
    from evogs_codec.format.directory import read_directory as read_directory
    from evogs_codec.io.finite import drop_non_finite as drop_non_finite
    from evogs_codec.io.finite import finite_opacities as finite_opacities
    from evogs_codec.io.interchange.gltf_stream import read_gltf_stream as read_gltf_stream
    from evogs_codec.io.interchange.gltf_stream_write import write_gltf_stream as write_gltf_stream
    from evogs_codec.io.interchange.scene_files import Scene as Scene
    from evogs_codec.io.interchange.scene_files import read_scene as read_scene
    from evogs_codec.io.interchange.scene_files import write_scene as write_scene
    from evogs_codec.io.ply import read_ply as read_ply
    from evogs_codec.io.ply import write_ply as write_ply
    from evogs_codec.io.tree_npz import read_tree as read_tree
    from evogs_codec.io.tree_npz import write_tree as write_tree
    from evogs_codec.jobs import Engine as Engine
    from evogs_codec.jobs import JobOptions as JobOptions
    from evogs_codec.jobs import encode_files as encode_files
    from evogs_codec.lifting.lift import Lifted as Lifted
    from evogs_codec.lifting.lift import lift as lift
    from evogs_codec.lifting.lift import lift_with_order as lift_with_order
    from evogs_codec.lifting.shared_sh import with_palette as with_palette
    from evogs_codec.model.palette import Palette as Palette
    from evogs_codec.model.scene_info import SceneInfo as SceneInfo
    from evogs_codec.model.splats import SplatParams as SplatParams
    from evogs_codec.model.tree import EvolutionTree as EvolutionTree
    from evogs_codec.model.tree import Kind as Kind
    from evogs_codec.model.tree import Step as Step
    from evogs_codec.scene import EncodedScene as EncodedScene
    from evogs_codec.scene import encode_scene as encode_scene
    from evogs_codec.scene import encode_scene_with_order as encode_scene_with_order
    from evogs_codec.scene import encode_tree as encode_tree
    from evogs_codec.scene import encode_tree_with_order as encode_tree_with_order
    from evogs_codec.stores.client import put_object as put_object
    from evogs_codec.stores.remote_file import RemoteFile as RemoteFile

__all__ = [
    "PRESETS",
    "AccuracyWarning",
    "Cut",
    "Decoded",
    "Decoder",
    "Directory",
    "EncodedScene",
    "Engine",
    "EvogsError",
    "EvolutionTree",
    "Fault",
    "FixedSteps",
    "InputError",
    "JobOptions",
    "Kind",
    "LevelPsnr",
    "Lifted",
    "NearLossless",
    "NotRepresentableError",
    "Palette",
    "Pictures",
    "Progress",
    "RangeBits",
    "RemoteFile",
    "Scene",
    "SceneInfo",
    "Settings",
    "SplatParams",
    "Step",
    "StepReady",
    "StepTable",
    "StreamError",
    "TargetEncoder",
    "TargetMissedError",
    "__version__",
    "byte_ranges",
    "choose_cut",
    "decode",
    "decode_leaves",
    "decode_prefix",
    "drop_non_finite",
    "encode",
    "encode_files",
    "encode_scene",
    "encode_scene_with_order",
    "encode_tree",
    "encode_tree_with_order",
    "extract",
    "finite_opacities",
    "leaf_order",
    "level_psnr",
    "lift",
    "lift_with_order",
    "put_object",
    "read_directory",
    "read_gltf_stream",
    "read_ply",
    "read_scene",
    "read_tree",
    "with_palette",
    "write_gltf_stream",
    "write_ply",
    "write_scene",
    "write_tree",
]

# Where each of these names is.
_MODULES = {
    "common.progress": ("Progress",),
    "common.version": ("__version__",),
    "decoding.byte_ranges": ("byte_ranges",),
    "decoding.cut": ("Cut",),
    "decoding.decode": ("Decoded", "decode", "decode_leaves", "decode_prefix"),
    "decoding.progressive": ("Decoder", "StepReady"),
    "editing.extract": ("choose_cut", "extract"),
    "editing.level_psnr": ("LevelPsnr", "level_psnr"),
    "encoding.arrange": ("leaf_order",),
    "encoding.encode": ("encode",),
    "encoding.grids": ("AccuracyWarning", "NotRepresentableError"),
    "encoding.pictures": ("Pictures",),
    "encoding.settings": (
        "PRESETS",
        "FixedSteps",
        "NearLossless",
        "RangeBits",
        "Settings",
        "StepTable",
    ),
    "encoding.out_of_reach": ("TargetMissedError",),
    "encoding.targets": ("TargetEncoder",),
    "errors": ("EvogsError", "Fault", "InputError", "StreamError"),
    "format.directory": ("Directory", "read_directory"),
    "io.finite": ("drop_non_finite", "finite_opacities"),
    "io.interchange.gltf_stream": ("read_gltf_stream",),
    "io.interchange.gltf_stream_write": ("write_gltf_stream",),
    "io.interchange.scene_files": ("Scene", "read_scene", "write_scene"),
    "io.ply": ("read_ply", "write_ply"),
    "io.tree_npz": ("read_tree", "write_tree"),
    "jobs": ("Engine", "JobOptions", "encode_files"),
    "lifting.lift": ("Lifted", "lift", "lift_with_order"),
    "lifting.shared_sh": ("with_palette",),
    "model.scene_info": ("SceneInfo",),
    "model.splats": ("SplatParams",),
    "model.palette": ("Palette",),
    "model.tree": ("EvolutionTree", "Kind", "Step"),
    "scene": (
        "EncodedScene",
        "encode_scene",
        "encode_scene_with_order",
        "encode_tree",
        "encode_tree_with_order",
    ),
    "stores.client": ("put_object",),
    "stores.remote_file": ("RemoteFile",),
}
_MODULE_OF = {name: module for module, names in _MODULES.items() for name in names}


def __getattr__(name: str) -> object:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
