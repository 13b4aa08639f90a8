/**
 * Pictures of which only some pixels are known, filled and blurred as skylight.portrait._gain
 * does. Pictures have one number a pixel; unknown ones are 0.
 */

/** Makes no garbage: 15 times a second that would be a hundred megabytes. */
class Scratch {
  private readonly kept = new Map<string, Float32Array>();
  take(name: string, length: number): Float32Array {
    let array = this.kept.get(name);
    if (array?.length !== length) this.kept.set(name, (array = new Float32Array(length)));
    return array;
  }
}

interface Level {
  width: number;
  height: number;
  /** 0 to 1. */
  known: Float32Array;
  /** One over the weights of the next level before they are cut off at 1. */
  over: Float32Array;
  scratch: Scratch;
  across: Int32Array;
  along: Int32Array;
}

/** The five pixels about each second one, reflected at the border. */
function taps(length: number): Int32Array {
  return Int32Array.from({ length: 5 * ((length + 1) >> 1) }, (_, i) =>
    reflected(2 * Math.floor(i / 5) + (i % 5) - 2, length),
  );
}

const reflected = (place: number, length: number): number => {
  if (length === 1) return 0;
  let at = place;
  while (at < 0 || at >= length) at = at < 0 ? -at : 2 * length - 2 - at;
  return at;
};

/** cv2.pyrDown: means with the binomial weights (1, 4, 6, 4, 1) / 16 along each axis. */
function down(picture: Float32Array, level: Omit<Level, "known" | "over">): Float32Array {
  const { width, height, across, along, scratch } = level;
  const line = across.length / 5;
  const half = scratch.take("half", line * height);
  for (let row = 0, to = 0; row < height; row++) {
    const start = row * width;
    for (let tap = 0; tap < across.length; tap += 5, to++) {
      const a = picture[start + across[tap]!]!;
      const b = picture[start + across[tap + 1]!]!;
      const c = picture[start + across[tap + 2]!]!;
      const d = picture[start + across[tap + 3]!]!;
      const e = picture[start + across[tap + 4]!]!;
      half[to] = a + e + 4 * (b + d) + 6 * c;
    }
  }
  const small = scratch.take("small", (line * along.length) / 5);
  for (let tap = 0, to = 0; tap < along.length; tap += 5) {
    const a = along[tap]! * line;
    const b = along[tap + 1]! * line;
    const c = along[tap + 2]! * line;
    const d = along[tap + 3]! * line;
    const e = along[tap + 4]! * line;
    for (let x = 0; x < line; x++, to++)
      small[to] =
        (half[a + x]! + half[e + x]! + 4 * (half[b + x]! + half[d + x]!) + 6 * half[c + x]!) / 256;
  }
  return small;
}

/** cv2.pyrUp: four times the pixels, or a row or column less. */
function up(small: Float32Array, { width, height, scratch }: Level): Float32Array {
  const [fromWidth, fromHeight] = [(width + 1) >> 1, (height + 1) >> 1];
  const wide = scratch.take("wide", width * fromHeight);
  for (let row = 0; row < fromHeight; row++) {
    const start = row * fromWidth;
    for (let x = 0, to = row * width; x < width; x++, to++) {
      const i = x >> 1;
      const here = small[start + i]!;
      const after = small[start + Math.min(i + 1, fromWidth - 1)]!;
      const before = small[start + (i > 0 ? i - 1 : Math.min(1, fromWidth - 1))]!;
      wide[to] = x & 1 ? (here + after) / 2 : (before + 6 * here + after) / 8;
    }
  }
  const large = scratch.take("large", width * height);
  for (let y = 0, to = 0; y < height; y++) {
    const i = y >> 1;
    const here = i * width;
    const after = Math.min(i + 1, fromHeight - 1) * width;
    const before = (i > 0 ? i - 1 : Math.min(1, fromHeight - 1)) * width;
    if (y & 1) for (let x = 0; x < width; x++, to++) large[to] = (wide[here + x]! + wide[after + x]!) / 2;
    else
      for (let x = 0; x < width; x++, to++)
        large[to] = (wide[before + x]! + 6 * wide[here + x]! + wide[after + x]!) / 8;
  }
  return large;
}

/** Push and pull (Gortler et al. 1996) by weights that stay. */
export class Filling {
  private readonly levels: Level[] = [];

  constructor(weights: Float32Array, width: number, height: number) {
    let known = weights;
    let [w, h] = [width, height];
    for (;;) {
      const level = { width: w, height: h, across: taps(w), along: taps(h), scratch: new Scratch() };
      const below = down(known, level).slice();
      this.levels.push({ ...level, known, over: below.map((value) => 1 / Math.max(value, 1e-12)) });
      if (Math.min(w, h) < 2) return;
      known = below.map((value) => Math.min(4 * value, 1));
      [w, h] = [(w + 1) >> 1, (h + 1) >> 1];
    }
  }

  /** The picture with what is unknown, in part or wholly, from its surroundings; until the next call. */
  fill(picture: Float32Array, level = 0): Float32Array {
    const here = this.levels[level]!;
    const { known, over } = here;
    if (Math.min(here.width, here.height) < 2) return meanFilled(picture, known);
    const masked = here.scratch.take("masked", picture.length);
    for (let i = 0; i < known.length; i++) masked[i] = known[i]! * picture[i]!;
    const coarse = down(masked, here);
    for (let i = 0; i < over.length; i++) coarse[i]! *= over[i]!;
    const pulled = up(this.fill(coarse, level + 1), here);
    for (let i = 0; i < known.length; i++) masked[i]! += (1 - known[i]!) * pulled[i]!;
    return masked;
  }
}

function meanFilled(picture: Float32Array, known: Float32Array): Float32Array {
  const total = known.reduce((sum, weight) => sum + weight, 0);
  const mean = known.reduce((sum, weight, i) => sum + weight * picture[i]!, 0) / total;
  return picture.map((value, i) => (known[i]! > 0 ? value : mean));
}

/** Gaussian means over some cells of a grid, each over the weight of the cells near it. */
export class Blur {
  private readonly kernel: Float32Array;
  /** The weight of the cells near each. */
  readonly below: Float32Array;
  private readonly scratch = new Scratch();
  private readonly some: Uint8Array;

  constructor(
    private readonly width: number,
    private readonly height: number,
    weights: Float32Array,
    sigma: number,
  ) {
    const radius = Math.round(sigma * 8 + 1) >> 1; // as cv2.GaussianBlur chooses it
    const bell = Float32Array.from({ length: 2 * radius + 1 }, (_, i) => Math.exp(-((i - radius) ** 2) / (2 * sigma ** 2)));
    const total = bell.reduce((sum, value) => sum + value, 0);
    this.kernel = bell.map((value) => value / total);
    this.some = new Uint8Array(height + 2 * radius);
    this.below = this.summed(weights).map((weight) => Math.max(weight, 1e-6));
  }

  /** Of weights times values, all over the grid; until the next call. */
  of(weighted: Float32Array): Float32Array {
    const sums = this.summed(weighted);
    for (let i = 0; i < sums.length; i++) sums[i]! /= this.below[i]!;
    return sums;
  }

  private summed(picture: Float32Array): Float32Array {
    const { width, height, kernel, scratch } = this;
    const radius = kernel.length >> 1;
    const line = scratch.take("line", width + 2 * radius);
    const across = scratch.take("across", width * (height + 2 * radius));
    const out = scratch.take("out", width * height);
    const some = this.some.fill(0); // rows without anything cost no time
    for (let row = 0; row < height; row++) {
      if (isBlack(picture, row * width, width)) continue;
      some[row + radius] = 1;
      for (let x = -radius; x < width + radius; x++)
        line[x + radius] = picture[row * width + reflected(x, width)]!;
      for (let x = 0, to = (row + radius) * width; x < width; x++, to++) {
        let sum = 0;
        for (let t = 0; t < kernel.length; t++) sum += kernel[t]! * line[x + t]!;
        across[to] = sum;
      }
    }
    for (let y = 1; y <= radius; y++)
      for (const row of [-y, height - 1 + y]) {
        const from = reflected(row, height) + radius;
        some[row + radius] = some[from]!;
        across.copyWithin((row + radius) * width, from * width, (from + 1) * width);
      }
    out.fill(0);
    for (let row = 0; row < height; row++)
      for (let t = 0; t < kernel.length; t++) {
        if (some[row + t] === 0) continue;
        const share = kernel[t]!;
        for (let x = 0, to = row * width, from = (row + t) * width; x < width; x++, to++, from++)
          out[to]! += share * across[from]!;
      }
    return out;
  }
}

function isBlack(picture: Float32Array, from: number, width: number): boolean {
  for (let at = from; at < from + width; at++) if (picture[at] !== 0) return false;
  return true;
}
