import { fromAngles, fromPixel, solidAngles, type Vec3 } from "../../shared/frame";
import { luminance } from "../../shared/radiance_map";
import { Blur, Filling } from "./filling";
import type { Person } from "./person";

const ROWS = 32; // of the directions that points see or not
const MARGIN = 4; // of the grid of skin
const SHARED_ROWS = 16; // as in skylight.portrait._relit
const CUT_OFF = 2.6; // spreads from its middle, beyond which a lobe is taken for black

/** Some pixels of the shading's picture: what textures are made of. */
export interface Grid {
  left: number;
  top: number;
  width: number;
  height: number;
  /** Pixels a cell. */
  step: number;
}

/** The person in a new light, three numbers a cell; until the next light. */
export interface Lit {
  /** On the grid of skin. */
  shading: Float32Array;
  glossy: Float32Array;
  /** On that of the whole person: what hair and clothes are multiplied by, as a logarithm. */
  ratio: Float32Array;
  /** How much of the light is that of the photograph. */
  common: number;
}

/** Some of the directions that points see or not, by pixel; a surface that faces it receives 1 of their weights. */
export interface Lobe {
  middle: Vec3;
  spreadRad: number;
  pixels: Int32Array;
  directions: Float32Array;
  weights: Float32Array;
}

/**
 * A von Mises-Fisher lobe of that spread per axis, no narrower than half a pixel of the grid of so
 * many rows. Of a wide one each second row and column does, for a quarter of the time.
 */
export function lobe(middle: Vec3, spreadRad: number, rows = ROWS): Lobe {
  const columns = 2 * rows;
  const pixelRad = Math.PI / rows;
  const spread = Math.max(spreadRad, pixelRad / 2);
  const step = spread > 1.6 * pixelRad ? 2 : 1;
  const solid = solidAngles(columns, rows);
  const found: { pixel: number; direction: Vec3; weight: number }[] = [];
  let facing = 0;
  for (let pixel = 0; pixel < rows * columns; pixel++) {
    const row = Math.floor(pixel / columns);
    if (row % step || pixel % step) continue;
    const direction = fromPixel(pixel % columns, row, columns, rows);
    const chord = 2 - 2 * (direction[0] * middle[0] + direction[1] * middle[1] + direction[2] * middle[2]);
    if (chord >= (CUT_OFF * spread) ** 2) continue;
    const weight = solid[row]! * Math.exp(-chord / (2 * spread ** 2));
    found.push({ pixel, direction, weight });
    facing += weight * Math.max(0, 1 - chord / 2);
  }
  return {
    middle,
    spreadRad,
    pixels: Int32Array.from(found, ({ pixel }) => pixel),
    directions: Float32Array.from(found.flatMap(({ direction }) => direction)),
    weights: Float32Array.from(found, ({ weight }) => weight / facing),
  };
}

/** A person under the fill, and a key light wherever it is put. */
export class KeyLight {
  /** About the skin, cell by pixel. */
  readonly skin: Grid;
  /** About all of the person, in cells of 2 x 2 pixels: what is blurred needs no more. */
  readonly whole: Grid;
  /** S_A, rho_0 and g_A of the photograph's own light, and how much skin there is, on the grid of skin. */
  readonly before: { shading: Float32Array; local: Float32Array; glossy: Float32Array; inside: Float32Array };
  /** The mean luminance of S_A on skin. */
  readonly level: number;
  /** Cells of the points, in either grid; -1 for none. */
  private readonly onSkin: Int32Array;
  private readonly onWhole: Int32Array;
  private readonly fromSkin: Filling;
  private readonly fromAll: Filling;
  private readonly blur: Blur;
  private readonly covered: Float32Array;
  private readonly softBefore: Float32Array[];
  private readonly softRest: Float32Array[];
  private readonly restShading: Float32Array;
  private readonly restGlossy: Float32Array;
  private readonly meanBefore: Float32Array;
  private readonly meanRest: Float32Array;

  constructor(private readonly person: Person) {
    const { facts, places, bare } = person;
    const [left, top, width, height] = facts.crop;
    this.skin = gridAbout(person);
    this.whole = { left, top, width: (width + 1) >> 1, height: (height + 1) >> 1, step: 2 };
    this.onSkin = this.cells(this.skin);
    this.onWhole = this.cells(this.whole);
    const skin = bare.map((share) => Math.max(share, facts.hair_counts));
    this.fromSkin = new Filling(this.summed(skin, 1, this.skin, this.onSkin), this.skin.width, this.skin.height);
    const counts = this.summed(new Float32Array(places.length).fill(1), 1, this.whole, this.onWhole);
    this.covered = counts.map((count) => Number(count > 0));
    this.fromAll = new Filling(this.covered, this.whole.width, this.whole.height);
    this.blur = new Blur(this.whole.width, this.whole.height, counts, facts.soft_px / this.whole.step);
    this.softBefore = [0, 1, 2].map((k) => this.soft(person.shading, 3, k).slice());
    this.softRest = [0, 1, 2].map((k) => this.soft(person.restShading, 3, k).slice());
    this.meanBefore = this.meanOnSkin(person.shading, 3);
    this.meanRest = this.meanOnSkin(person.restShading, 3);
    this.level = luminance(this.meanBefore[0]!, this.meanBefore[1]!, this.meanBefore[2]!);
    const filled = (values: Float32Array): Float32Array =>
      this.fromSkin.fill(this.summed(values, 3, this.skin, this.onSkin), 3).slice();
    this.restShading = filled(person.restShading);
    this.restGlossy = filled(person.restGlossy);
    this.before = {
      shading: filled(person.shading),
      local: filled(person.local),
      glossy: filled(person.glossy),
      inside: this.summed(person.inside, 1, this.skin, this.onSkin),
    };
  }

  /** `sum_w g(w) V(w) <n, w>+ dw / pi` at each point, and as much of the gloss; two numbers a point. */
  transport({ middle, spreadRad, pixels, directions, weights }: Lobe): Float32Array {
    const { normals, views, visible, facts } = this.person;
    const [x, y, z] = middle;
    const bytes = (ROWS * ROWS * 2) / 8;
    // halfway vectors are spread by half as much: as rough a surface shows a light that is narrow
    const a2 = facts.lobe.alpha ** 2 + spreadRad ** 2 / 2;
    const { f0 } = facts.lobe;
    const out = new Float32Array((2 * normals.length) / 3);
    for (let i = 0, at = 0; at < normals.length; i++, at += 3) {
      const nx = normals[at]!;
      const ny = normals[at + 1]!;
      const nz = normals[at + 2]!;
      let seen = 0;
      for (let k = 0, of = 0; k < pixels.length; k++, of += 3) {
        const pixel = pixels[k]!;
        if (!((visible[i * bytes + (pixel >> 3)]! >> (pixel & 7)) & 1)) continue;
        const cosine = nx * directions[of]! + ny * directions[of + 1]! + nz * directions[of + 2]!;
        if (cosine > 0) seen += weights[k]! * cosine;
      }
      if (seen === 0) continue;
      const vx = views[at]!;
      const vy = views[at + 1]!;
      const vz = views[at + 2]!;
      const nl = Math.max(nx * x + ny * y + nz * z, 1e-2);
      const nv = Math.max(nx * vx + ny * vy + nz * vz, 1e-2);
      const lv = vx * x + vy * y + vz * z;
      // skylight.transport._render.ggx
      const length = Math.sqrt(Math.max(2 + 2 * lv, 1e-6));
      const nh = Math.min((nl + nv) / length, 1);
      const density = a2 / (Math.PI * (nh * nh * (a2 - 1) + 1) ** 2);
      const masking =
        0.5 / (nl * Math.sqrt(nv * nv * (1 - a2) + a2) + nv * Math.sqrt(nl * nl * (1 - a2) + a2));
      const fresnel = f0 + (1 - f0) * (1 - Math.min(length / 2, 1)) ** 5;
      out[2 * i] = seen / Math.PI;
      out[2 * i + 1] = facts.gloss * seen * density * masking * fresnel;
    }
    return out;
  }

  /**
   * The person with the key there, so wide and so many times as bright as the fill: the formulas of
   * skylight.portrait._keys.
   */
  under(azimuthDeg: number, zenithDeg: number, strength: number, sizeDeg: number): Lit {
    const { facts } = this.person;
    const dimmed = facts.ball / (facts.fill * (1 + strength * facts.metered));
    const key = facts.colour.map((value) => dimmed * strength * facts.fill * value) as [number, number, number];
    // a disc's diameter is four spreads of a lobe
    const from = lobe(fromAngles(azimuthDeg, zenithDeg), (sizeDeg * Math.PI) / 180 / 4);
    const transport = this.transport(from);
    const gains = this.gains(transport, key, dimmed);
    const filled = this.fromSkin.fill(this.summed(transport, 2, this.skin, this.onSkin), 2);
    const shading = new Float32Array(this.restShading.length);
    const glossy = new Float32Array(this.restGlossy.length);
    for (let i = 0, at = 0; at < shading.length; i += 2)
      for (let k = 0; k < 3; k++, at++) {
        shading[at] = gains[k]! * (dimmed * this.restShading[at]! + key[k]! * filled[i]!);
        glossy[at] = gains[k]! * (dimmed * this.restGlossy[at]! + key[k]! * filled[i + 1]!);
      }
    const soft = this.soft(transport, 2, 0);
    const base = facts.base * this.level;
    const ratio = new Float32Array(3 * soft.length);
    for (let i = 0; i < soft.length; i++) {
      if (this.covered[i] === 0) continue;
      for (let k = 0; k < 3; k++) {
        const now = gains[k]! * (dimmed * this.softRest[k]![i]! + key[k]! * soft[i]!);
        ratio[3 * i + k] = Math.log((now + base) / (this.softBefore[k]![i]! + base));
      }
    }
    return { shading, glossy, ratio: this.fromAll.fill(ratio, 3), common: this.common(from, key, dimmed) };
  }

  /** One channel of the points' values, smoothed over the whole person. */
  private soft(values: Float32Array, channels: number, channel: number): Float32Array {
    const sums = new Float32Array(this.covered.length);
    this.onWhole.forEach((cell, i) => (sums[cell]! += values[channels * i + channel]!));
    return this.blur.of(sums);
  }

  /** White is balanced so that the mean shading of skin keeps its colour: it is the same place. */
  private gains(transport: Float32Array, key: [number, number, number], dimmed: number): number[] {
    const lit = this.meanOnSkin(transport, 2)[0]!;
    const received = key.map((value, k) => dimmed * this.meanRest[k]! + value * lit);
    if (received.some((value) => value === 0)) return [1, 1, 1];
    const gains = received.map((value, k) => this.meanBefore[k]! / value);
    const [r, g, b] = received as [number, number, number];
    const keep = luminance(r, g, b) / luminance(gains[0]! * r, gains[1]! * g, gains[2]! * b);
    return gains.map((gain) => gain * keep);
  }

  /** `max(0, 1 - |p - q|_1)` of skylight.portrait._relit.shared_light. */
  private common({ middle, spreadRad }: Lobe, key: [number, number, number], dimmed: number): number {
    const { foundPower, restPower } = this.person;
    const power = restPower.map((value) => dimmed * value);
    const rows = 4 * SHARED_ROWS;
    const { pixels, weights } = lobe(middle, spreadRad, rows);
    pixels.forEach((pixel, k) => {
      const row = Math.floor(pixel / (2 * rows) / 4);
      const column = Math.floor((pixel % (2 * rows)) / 4);
      power[row * 2 * SHARED_ROWS + column]! += weights[k]! * luminance(...key);
    });
    const sum = (of: Float32Array): number => of.reduce((total, value) => total + value, 0);
    const [was, is] = [sum(foundPower), sum(power)];
    let apart = 0;
    power.forEach((value, i) => (apart += Math.abs(value / is - foundPower[i]! / was)));
    return Math.max(0, 1 - apart);
  }

  private meanOnSkin(values: Float32Array, channels: number): Float32Array {
    const sums = new Float64Array(channels);
    let total = 0;
    this.person.bare.forEach((share, i) => {
      if (!(share > 0)) return;
      total++;
      for (let k = 0; k < channels; k++) sums[k]! += values[channels * i + k]!;
    });
    return Float32Array.from(sums, (sum) => sum / total);
  }

  /** In which cell each point is. */
  private cells({ left, top, width, height, step }: Grid): Int32Array {
    const [cropLeft, cropTop, cropWidth] = this.person.facts.crop;
    return this.person.places.map((place) => {
      const x = Math.floor(((place % cropWidth) + cropLeft - left) / step);
      const y = Math.floor((Math.floor(place / cropWidth) + cropTop - top) / step);
      return x < 0 || y < 0 || x >= width || y >= height ? -1 : y * width + x;
    });
  }

  /** The points' values summed over the cells of a grid. */
  private summed(values: Float32Array, channels: number, grid: Grid, cells: Int32Array): Float32Array {
    const picture = new Float32Array(channels * grid.width * grid.height);
    for (let i = 0; i < cells.length; i++) {
      if (cells[i]! < 0) continue;
      for (let k = 0; k < channels; k++) picture[channels * cells[i]! + k]! += values[channels * i + k]!;
    }
    return picture;
  }
}

/** The pixels with skin and a few about them. */
function gridAbout({ facts, places, bare }: Person): Grid {
  const [cropLeft, cropTop, width, height] = facts.crop;
  let [left, top, right, foot] = [width, height, 0, 0];
  places.forEach((place, i) => {
    if (!(bare[i]! > 0)) return;
    left = Math.min(left, place % width);
    right = Math.max(right, place % width);
    top = Math.min(top, Math.floor(place / width));
    foot = Math.max(foot, Math.floor(place / width));
  });
  left = Math.max(0, left - MARGIN);
  top = Math.max(0, top - MARGIN);
  right = Math.min(width, right + 1 + MARGIN);
  foot = Math.min(height, foot + 1 + MARGIN);
  return { left: cropLeft + left, top: cropTop + top, width: right - left, height: foot - top, step: 1 };
}
