import { fromAngles, fromPixel, solidAngles, type Vec3 } from "../../shared/frame";
import { luminance } from "../../shared/radiance_map";
import { Blur, Filling } from "./filling";
import type { Person } from "./person";

const ROWS = 32; // of the directions that points see or not
const SHARED_ROWS = 16; // as in skylight.portrait._relit
const CUT_OFF = 5; // spreads from its middle, beyond which a lobe is taken for black
const QUICK_CUT_OFF = 2.6; // and where the light is to follow at once

/** Some pixels of the shading's picture: what textures are made of. */
export interface Grid {
  left: number;
  top: number;
  width: number;
  height: number;
  /** Pixels a cell. */
  step: number;
}

/** What a new light changes, in logarithms; until the next light. */
export interface Lit {
  /** Of colour (three numbers a cell) and of level. */
  gain: Float32Array;
  /** The mean change of level over skin. */
  typical: number;
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
 * many rows. A quick one is cut off earlier, and of a wide one each second row and column does, for
 * a quarter of the time.
 */
export function lobe(middle: Vec3, spreadRad: number, rows = ROWS, isQuick = true): Lobe {
  const columns = 2 * rows;
  const pixelRad = Math.PI / rows;
  const spread = Math.max(spreadRad, pixelRad / 2);
  const step = isQuick && spread > 1.6 * pixelRad ? 2 : 1;
  const reach = (isQuick ? QUICK_CUT_OFF : CUT_OFF) * spread;
  const solid = solidAngles(columns, rows);
  const found: { pixel: number; direction: Vec3; weight: number }[] = [];
  let facing = 0;
  for (let pixel = 0; pixel < rows * columns; pixel++) {
    const row = Math.floor(pixel / columns);
    if (row % step || pixel % step) continue;
    const direction = fromPixel(pixel % columns, row, columns, rows);
    const chord = 2 - 2 * (direction[0] * middle[0] + direction[1] * middle[1] + direction[2] * middle[2]);
    if (chord >= reach ** 2) continue;
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

/** Of light from there, on what the camera sees of a ball: skylight.portrait._keys.ball_weights. */
function ballWeight(towards: Vec3): number {
  const cosine = Math.min(Math.max(towards[2], -1), 1);
  const angle = Math.acos(cosine);
  return (2 / (3 * Math.PI)) * (Math.sin(angle) + (Math.PI - angle) * cosine);
}

/** A person under the fill, and a key light wherever it is put. */
export class KeyLight {
  /** About all of the person, in cells of 2 x 2 pixels: what is blurred needs no more. */
  readonly grid: Grid;
  /** The cell of each point. */
  private readonly cell: Int32Array;
  private readonly filling: Filling;
  private readonly sharp: Blur;
  private readonly soft: Blur;
  private readonly tint: Blur;
  /** How much of a cell is skin, in itself and with its neighbours. */
  private readonly bare: Float32Array;
  private readonly skin: Float32Array;
  private readonly unseenTint: Float32Array;
  private readonly skinTint: Float32Array;
  /** skylight.portrait._gain.Level of the light found, and its colour (three numbers a cell). */
  private readonly before: Float32Array;
  private readonly colour: Float32Array;

  constructor(private readonly person: Person) {
    const { facts, places, shading, glossy } = person;
    const [left, top, width, height] = facts.crop;
    const grid = { left, top, width: (width + 1) >> 1, height: (height + 1) >> 1, step: 2 };
    this.grid = grid;
    this.cell = places.map((place) => ((Math.floor(place / width) >> 1) * grid.width) + ((place % width) >> 1));
    const counts = this.summed(new Float32Array(places.length).fill(1), 1);
    const blurs = facts.sigmas_px.map((sigma) => new Blur(grid.width, grid.height, counts, sigma / grid.step));
    [this.sharp, this.soft, this.tint] = blurs as [Blur, Blur, Blur];
    const known = this.summed(person.known, 1);
    this.filling = new Filling(known.map((sum, i) => sum / Math.max(counts[i]!, 1)), grid.width, grid.height);
    this.bare = this.summed(person.bare, 1);
    this.skin = this.sharp.of(this.bare).slice();
    const mean3 = (values: Float32Array): Float32Array =>
      this.summed(values, 3).map((sum, i) => sum / Math.max(counts[Math.floor(i / 3)]!, 1));
    this.unseenTint = mean3(person.unseenTint);
    this.skinTint = mean3(person.skinTint);
    this.colour = this.colourOf(shading);
    this.before = this.levelOf(luminances(shading), luminances(glossy)).level;
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
    const { facts, occlusion, fillGloss } = this.person;
    const towards = fromAngles(azimuthDeg, zenithDeg);
    const dimmed = facts.ball / (facts.fill * (1 + strength * ballWeight(towards)));
    // a disc's diameter is four spreads of a lobe
    const from = lobe(towards, (sizeDeg * Math.PI) / 180 / 4);
    const transport = this.transport(from);
    // fill and key are of one colour, so all that they light is
    const lightOf = (ofFill: Float32Array, offset: number): Float32Array =>
      ofFill.map((share, i) => dimmed * facts.fill * (share + strength * transport[2 * i + offset]!));
    const after = this.levelOf(lightOf(occlusion, 0), lightOf(fillGloss, 1));
    const level = after.level.map((value, i) => value - this.before[i]!);
    const common = this.common(from, dimmed, strength);
    const ours = facts.colour.map((value) => Math.log(Math.max(value, 1e-3)));
    const colour = this.colour.map((value, i) => ours[i % 3]! - value);
    // white is balanced so that skin keeps its mean colour: it is the same place
    const isBalanced = after.mean > 0;
    const cast = this.meanOfCells(colour, 3);
    const shift = this.meanOfCells(this.unseenTint, 3).map((value) => (1 - common) * value);
    const gain = new Float32Array(4 * level.length);
    for (let i = 0; i < level.length; i++) {
      for (let k = 0; k < 3; k++) {
        const mean = (isBalanced ? 0 : cast[k]!) + shift[k]!;
        const own = colour[3 * i + k]! - (isBalanced ? cast[k]! : 0) + (1 - common) * this.unseenTint[3 * i + k]!;
        const near = mean + facts.tinted * Math.tanh((own - mean) / facts.tinted);
        gain[4 * i + k] = near + (1 - Math.exp(-Math.abs(level[i]!))) * this.skinTint[3 * i + k]!;
      }
      gain[4 * i + 3] = level[i]!;
    }
    return { gain: this.filling.fill(gain, 4), typical: this.meanOfCells(level, 1)[0]!, common };
  }

  /** Of luminances of shading and gloss, one number a point; and the mean shading of skin. */
  private levelOf(shading: Float32Array, glossy: Float32Array): { level: Float32Array; mean: number } {
    const { base, shine } = this.person.facts;
    const mean = this.meanOnSkin(shading);
    const whole = this.summed(shading.map((value, i) => value + shine * glossy[i]!), 1);
    const near = this.sharp.of(whole);
    const far = this.soft.of(whole);
    const level = near.map((value, i) => {
      const skin = this.skin[i]!;
      return Math.log(Math.max(skin * value + (1 - skin) * far[i]! + base * mean, 1e-9));
    });
    return { level, mean };
  }

  private colourOf(shading: Float32Array): Float32Array {
    const sums = this.summed(shading, 3);
    const [red, green, blue] = [0, 1, 2].map((k) => this.tint.of(sums.filter((_, i) => i % 3 === k)).slice());
    const colour = new Float32Array(sums.length);
    for (let i = 0; i < red!.length; i++) {
      const own = [red![i]!, green![i]!, blue![i]!] as const;
      const bright = Math.max(luminance(...own), 1e-9);
      for (let k = 0; k < 3; k++) colour[3 * i + k] = Math.log(Math.max(own[k]! / bright, 1e-3));
    }
    return colour;
  }

  /** `max(0, 1 - |p - q|_1)` of skylight.portrait._relit.shared_light. */
  private common({ middle, spreadRad }: Lobe, dimmed: number, strength: number): number {
    const { foundPower, facts } = this.person;
    // an even light of radiance 1 makes the ball as bright as pi
    const solid = solidAngles(2 * SHARED_ROWS, SHARED_ROWS);
    const power = foundPower.map((_, i) => ((dimmed * facts.fill) / Math.PI) * solid[Math.floor(i / (2 * SHARED_ROWS))]!);
    const rows = 4 * SHARED_ROWS;
    const { pixels, weights } = lobe(middle, spreadRad, rows, false);
    pixels.forEach((pixel, k) => {
      const row = Math.floor(pixel / (2 * rows) / 4);
      const column = Math.floor((pixel % (2 * rows)) / 4);
      power[row * 2 * SHARED_ROWS + column]! += weights[k]! * dimmed * strength * facts.fill;
    });
    const sum = (of: Float32Array): number => of.reduce((total, value) => total + value, 0);
    const [was, is] = [sum(foundPower), sum(power)];
    let apart = 0;
    power.forEach((value, i) => (apart += Math.abs(value / is - foundPower[i]! / was)));
    return Math.max(0, 1 - apart);
  }

  private meanOnSkin(values: Float32Array): number {
    let [sum, total] = [0, 0];
    this.person.bare.forEach((share, i) => {
      if (!(share > 0)) return;
      total++;
      sum += values[i]!;
    });
    return sum / total;
  }

  private meanOfCells(values: Float32Array, channels: number): number[] {
    const sums = new Array<number>(channels).fill(0);
    let total = 0;
    this.bare.forEach((share, i) => {
      if (!(share > 0)) return;
      total += share;
      for (let k = 0; k < channels; k++) sums[k]! += share * values[channels * i + k]!;
    });
    return sums.map((sum) => sum / total);
  }

  /** The points' values summed over the cells. */
  private summed(values: Float32Array, channels: number): Float32Array {
    const picture = new Float32Array(channels * this.grid.width * this.grid.height);
    for (let i = 0; i < this.cell.length; i++)
      for (let k = 0; k < channels; k++) picture[channels * this.cell[i]! + k]! += values[channels * i + k]!;
    return picture;
  }
}

const luminances = (values: Float32Array): Float32Array =>
  new Float32Array(values.length / 3).map((_, i) => luminance(values[3 * i]!, values[3 * i + 1]!, values[3 * i + 2]!));
