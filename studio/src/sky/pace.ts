const RESTING = 1.4;
const LEAST = 0.33;

/**
 * How sharp a picture may be that is drawn again and again, as a factor of its sides: where frames
 * come slower than `slow` ms, fewer pixels are drawn; as soon as nothing has moved for a moment,
 * more than the screen has, against jagged edges.
 */
export class Pace {
  private last = 0;
  private moving = 1;
  private rest = 0;

  constructor(
    private readonly changed: (sharpness: number) => void,
    private readonly slow = 38,
  ) {}

  /** To be called with each frame that shows something new, before it is drawn. */
  frame(now: number): void {
    const took = now - this.last;
    this.last = now;
    const resting = !this.rest;
    clearTimeout(this.rest);
    this.rest = window.setTimeout(() => {
      this.rest = 0;
      this.changed(RESTING);
    }, 300);
    const before = this.moving;
    if (took > this.slow && took < 300) this.moving = Math.max(LEAST, this.moving * 0.85);
    if (resting || this.moving !== before) this.changed(this.moving);
  }

  stop(): void {
    clearTimeout(this.rest);
  }
}
