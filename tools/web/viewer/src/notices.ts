/** What is told in the picture: of the scene, of the graphics processor and of the page, and after what wait. */

import { element } from "./elements.js";
import type { FromWorker, Progress } from "./messages.js";
import { failureText, progressText, quietText } from "./words.js";

/** What notices are about. Of several the last in this order is shown. */
const TOPICS = ["scene", "graphics", "page"] as const;
type Topic = (typeof TOPICS)[number];
/** Notices about what was done to the page are shown so long, in ms. */
const BRIEFLY = 4000;
/** The page says that it waits after so many seconds without a byte. */
const QUIET = 5;

export class Notices {
  /** A failure of the scene is told, until bytes come again. */
  hasFailed = false;
  private readonly told = new Map<Topic, { text: string; canRetry: boolean }>();
  private briefTimer: ReturnType<typeof setTimeout> | undefined;
  private quietTimer: ReturnType<typeof setTimeout> | undefined;
  /** Of the scene, what came last. */
  private progress: Progress | null = null;
  private fetched = 0;
  /** Bytes are waited for. */
  private isBusy = false;
  /** Bytes are waited for, and none came for a while. */
  private isQuiet = false;

  constructor(onRetry: () => void) {
    element("retry").addEventListener("click", onRetry);
  }

  /** Another scene is opened: nothing is told of the one before. */
  open(): void {
    this.hasFailed = false;
    this.progress = null;
    this.fetched = 0;
    this.isBusy = true;
    this.awaitBytes();
    this.hide("scene");
  }

  /** Tells how the scene comes, if there is a reason to. */
  show(progress: Progress): void {
    this.progress = progress;
    const isBusy = progress.state !== "stopped" && !progress.isPaused;
    if (progress.fetched > this.fetched) this.hasFailed = false;
    if (progress.fetched > this.fetched || isBusy !== this.isBusy) {
      this.fetched = progress.fetched;
      this.isBusy = isBusy;
      this.awaitBytes();
    }
    if (!this.hasFailed) this.tellOfScene();
  }

  /** Tells that the scene does not go on. */
  fail(message: Extract<FromWorker, { kind: "failed" }>, hasPicture: boolean): void {
    const { text, canRetry } = failureText(message, hasPicture);
    this.tell(text, canRetry);
    clearTimeout(this.quietTimer);
    this.hasFailed = true;
  }

  /** Tells something until it is over. */
  tell(text: string, canRetry = false, topic: Topic = "scene"): void {
    this.told.set(topic, { text, canRetry });
    this.render();
  }

  /** Tells something of the page for a while. */
  tellBriefly(text: string): void {
    clearTimeout(this.briefTimer);
    this.briefTimer = setTimeout(() => this.hide("page"), BRIEFLY);
    this.tell(text, false, "page");
  }

  hide(topic: Topic): void {
    this.told.delete(topic);
    this.render();
  }

  /** Tells that nothing comes, if that is so for a while. */
  private awaitBytes(): void {
    clearTimeout(this.quietTimer);
    this.isQuiet = false;
    if (!this.isBusy) return;
    this.quietTimer = setTimeout(() => {
      this.isQuiet = true;
      if (!this.hasFailed) this.tellOfScene();
    }, 1000 * QUIET);
  }

  private tellOfScene(): void {
    const { progress } = this;
    const text = progress === null ? "" : progressText(progress);
    if (text !== "") this.tell(text, (progress?.failedFiles?.length ?? 0) > 0);
    else if (this.isQuiet) this.tell(quietText(QUIET));
    else this.hide("scene");
  }

  private render(): void {
    const topic = TOPICS.filter((topic) => this.told.has(topic)).pop();
    const { text, canRetry } = (topic && this.told.get(topic)) ?? { text: "", canRetry: false };
    // A text that is set again would be read aloud again.
    if (element("notice-text").textContent !== text) element("notice-text").textContent = text;
    element("retry").hidden = !canRetry;
    element("notice").hidden = text === "";
  }
}
