import DecoderWorker from "./decoder.worker?worker";
import type { Answer, Sky, Start, Wish } from "./decoder.worker";
import type { Rgb } from "./latlong";
import type { Receivers } from "./transport";

/** What the server says about the latents (GET /api/sky.json). */
export interface Latents {
  components: number[][];
  sigmas: number[];
  mean: number[];
  shares: number[];
  /** What the components do when they are raised. */
  names: string[];
  ground_albedo: Rgb;
}

/**
 * The decoder beside the page. At most one wish is under way and one waits: of those that come
 * faster than skies do, the newest counts.
 */
export class Decoder {
  private readonly worker = new DecoderWorker();
  private busy = true;
  private waiting: Wish | undefined;

  constructor(
    private readonly onSky: (sky: Sky) => void,
    private readonly onFailure: (message: string) => void,
  ) {
    this.worker.onmessage = ({ data }: MessageEvent<Answer>) => this.hear(data);
    this.worker.onerror = (event) => this.onFailure(event.message || "the decoder could not be loaded");
  }

  start(decoder: ArrayBuffer, receivers: Receivers): void {
    const start: Start = { kind: "start", decoder, receivers };
    this.worker.postMessage(start, [decoder]);
  }

  show(wish: Wish): void {
    this.waiting = wish;
    if (!this.busy) this.next();
  }

  stop(): void {
    this.worker.terminate();
  }

  private next(): void {
    if (this.waiting) this.worker.postMessage(this.waiting);
    this.busy = this.waiting !== undefined;
    this.waiting = undefined;
  }

  private hear(answer: Answer): void {
    if (answer.kind === "failed") return this.onFailure(answer.message);
    this.next(); // before the answer is drawn, so that both go on at once
    if (answer.kind === "sky") this.onSky(answer);
  }
}
