/** The controls and figures beside the picture. */

import { element } from "./elements.js";
import type { Progress, SceneInfo, Wants } from "./messages.js";
import { bytes, count, verified } from "./words.js";

/** Positions of the sliders for bytes per second and splats; the last one means no limit. */
const SLIDER_END = 100;
const SLOWEST = 5e3;
const FASTEST = 2e7;
const FEWEST = 500;
/** Splats of a tileset that does not say how many it has. */
const UNKNOWN = 3e6;

export interface PanelEvents {
  onWants(): void;
  onScrub(bytes: number | null): void;
  onFile(file: File): void;
  onUrl(url: string): void;
  onFit(): void;
  onUp(): void;
  onLink(): void;
  onFly(isFlying: boolean): void;
}

export class Panel {
  private readonly rate = element<HTMLInputElement>("rate");
  private readonly budget = element<HTMLInputElement>("budget");
  private readonly degree = element<HTMLInputElement>("degree");
  private readonly pause = element<HTMLButtonElement>("pause");
  private readonly timeline = element<HTMLInputElement>("timeline");
  private readonly bar = element("bar");
  private isPaused = false;
  private info: SceneInfo | null = null;
  private received = 0;

  constructor(private readonly events: PanelEvents) {
    for (const slider of [this.rate, this.budget, this.degree]) {
      slider.addEventListener("input", () => {
        this.showWants();
        events.onWants();
      });
    }
    this.pause.addEventListener("click", () => this.togglePause());
    this.timeline.addEventListener("input", () => {
      const at = Number(this.timeline.value);
      const isNow = at >= Number(this.timeline.max);
      events.onScrub(isNow ? null : at);
    });
    const picker = element<HTMLInputElement>("file");
    picker.addEventListener("change", () => {
      const file = picker.files?.[0];
      if (file) events.onFile(file);
      picker.value = "";
    });
    element("open").addEventListener("click", () => picker.click());
    element<HTMLFormElement>("address").addEventListener("submit", (event) => {
      event.preventDefault();
      const url = element<HTMLInputElement>("url").value.trim();
      if (url !== "") events.onUrl(url);
    });
    element("fit").addEventListener("click", () => events.onFit());
    element("up").addEventListener("click", () => events.onUp());
    element("link").addEventListener("click", () => events.onLink());
    const fly = element<HTMLInputElement>("fly");
    fly.addEventListener("change", () => events.onFly(fly.checked));
    this.showWants();
  }

  get wants(): Wants {
    const rate = Number(this.rate.value);
    const budget = Number(this.budget.value);
    const most = Math.max(this.info?.splats || UNKNOWN, FEWEST);
    return {
      bytesPerSecond:
        rate >= SLIDER_END ? Number.POSITIVE_INFINITY : SLOWEST * (FASTEST / SLOWEST) ** (rate / SLIDER_END),
      splats:
        budget >= SLIDER_END
          ? Number.POSITIVE_INFINITY
          : Math.round(FEWEST * (most / FEWEST) ** (budget / SLIDER_END)),
      shDegree: Number(this.degree.value),
      isPaused: this.isPaused,
    };
  }

  /** Sets the slider of the rate, as a link may ask. */
  setRate(bytesPerSecond: number): void {
    const at = (SLIDER_END * Math.log(bytesPerSecond / SLOWEST)) / Math.log(FASTEST / SLOWEST);
    this.rate.value = String(Math.min(SLIDER_END, Math.max(0, at)));
    this.showWants();
  }

  /** Leaves its title alone. */
  fold(): void {
    element<HTMLDetailsElement>("panel").open = false;
  }

  togglePause(): void {
    this.isPaused = !this.isPaused;
    this.pause.textContent = this.isPaused ? "Resume" : "Pause";
    this.pause.setAttribute("aria-pressed", String(this.isPaused));
    this.events.onWants();
  }

  /** A new scene is opened: nothing is known of it. */
  clear(name: string): void {
    this.info = null;
    this.received = 0;
    document.body.dataset.state = "open";
    this.degree.max = "3";
    this.budget.value = String(SLIDER_END);
    this.degree.value = "3";
    this.timeline.max = "0";
    this.timeline.value = "0";
    this.timeline.disabled = true;
    this.bar.style.width = "0";
    for (const id of ["bytes", "level", "splats", "verified", "requests"]) element(id).textContent = "–";
    element("verified").dataset.good = "false";
    element("brief").textContent = "";
    element("name").textContent = name;
    this.showWants();
  }

  opened(info: SceneInfo): void {
    this.info = info;
    this.degree.max = String(info.shDegree);
    this.degree.value = String(info.shDegree);
    this.degree.disabled = info.shDegree === 0;
    if (info.title !== "") element("name").textContent = info.title;
    this.showWants();
  }

  show(progress: Progress): void {
    const { info } = this;
    this.received = Math.max(this.received, progress.received);
    const size = progress.size ?? 0;
    element("bytes").textContent =
      size > 0 ? `${bytes(progress.received)} of ${bytes(size)}` : bytes(progress.received);
    this.bar.style.width = size > 0 ? `${(100 * progress.received) / size}%` : "0";
    if (info !== null) {
      const all = info.splats > 0 ? ` of ${count(info.splats)}` : "";
      element("splats").textContent = count(progress.splats) + all;
      const level = progress.level < 0 ? "–" : String(progress.level);
      element("level").textContent = `${level} of ${info.levels - 1}`;
      element("verified").textContent = verified(progress);
      element("verified").dataset.good = String(verified(progress) === "verified");
    }
    element("requests").textContent = String(progress.requests);
    const isWhole = progress.received >= size;
    element("brief").textContent =
      size === 0
        ? ""
        : isWhole
          ? bytes(size)
          : `${Math.floor((100 * progress.received) / size)} % of ${bytes(size)}`;
    const isLast = this.timeline.value === this.timeline.max;
    this.timeline.disabled = info === null || !info.canLookBack;
    this.timeline.max = String(this.received);
    if (isLast) this.timeline.value = String(this.received);
    this.timeline.setAttribute(
      "aria-valuetext",
      `${bytes(Number(this.timeline.value))} of ${bytes(this.received)}`,
    );
  }

  showFrames(perSecond: number | null): void {
    element("fps").textContent = perSecond === null ? "at rest" : perSecond.toFixed(perSecond < 10 ? 1 : 0);
  }

  private showWants(): void {
    const { bytesPerSecond, splats, shDegree } = this.wants;
    this.showValue(this.rate, Number.isFinite(bytesPerSecond) ? `${bytes(bytesPerSecond)}/s` : "no limit");
    this.showValue(this.budget, Number.isFinite(splats) ? count(splats) : "all");
    this.showValue(this.degree, String(shDegree));
  }

  /** What the position of a slider means. */
  private showValue(slider: HTMLInputElement, text: string): void {
    element(`${slider.id}-value`).textContent = text;
    slider.setAttribute("aria-valuetext", text);
  }
}
