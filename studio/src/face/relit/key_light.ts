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
  /** Of level, one number a cell. */
  gain: Float32Array;
  /** Which share of the face's light came from itself, in the new light and the one found; of a cell. */
  hollow: { after: Float32Array; before: Float32Array };
  /** The mean change of level over the face. */
  typical: number;
  edge: Edge;
  /** How much of the light is that of the photograph. */
  common: number;
}

/** skylight.portrait._gain.level_of a light, and which share of it is bounced; of a cell. */
interface Level {
  level: Float32Array;
  hollow: Float32Array;
}

/** A lamp behind the sitter: skylight.portrait._edge.EdgeLight. */
export interface Edge {
  direction: Vec3;
  strength: number;
  spreadRad: number;
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
  private readonly reach: Blur;
  private readonly around: Blur;
  /** How many pixels of a cell are the face's; and how much of the cell is, with a soft border. */
  private readonly face: Float32Array;
  private readonly share: Float32Array;
  /** By the light found, in luminance. */
  private readonly found: { diffuse: Float32Array; glossy: Float32Array };
  /** Of the light found, `hollow` continued beyond the face. */
  private readonly before: Level;

  constructor(private readonly person: Person) {
    const { facts, places, shading, glossy } = person;
    const [left, top, width, height] = facts.crop;
    const grid = { left, top, width: (width + 1) >> 1, height: (height + 1) >> 1, step: 2 };
    this.grid = grid;
    this.cell = places.map((place) => ((Math.floor(place / width) >> 1) * grid.width) + ((place % width) >> 1));
    this.face = this.summed(person.face);
    const [sharp, reach, around] = facts.sigmas_px;
    const blur = (weights: Float32Array, sigma: number): Blur => new Blur(grid.width, grid.height, weights, sigma / grid.step);
    this.sharp = blur(this.face, sharp);
    this.reach = blur(this.face, reach);
    this.around = blur(this.summed(person.face.map(() => 1)), around);
    const pixels = grid.step ** 2;
    const near = this.reach.below.map((weight) => Math.min(weight / pixels / facts.near, 1));
    this.filling = new Filling(near, grid.width, grid.height);
    this.share = new Float32Array(grid.width * grid.height);
    person.share.forEach((share, at) => {
      this.share[(Math.floor(at / width) >> 1) * grid.width + ((at % width) >> 1)]! += share / pixels;
    });
    this.found = { diffuse: luminances(shading), glossy: luminances(glossy) };
    const { level, hollow } = this.levelOf(this.found.diffuse, this.found.glossy);
    this.before = { level, hollow: this.continued(hollow) };
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
    const { diffuse: ofFound, glossy: glossOfFound } = this.found;
    const towards = fromAngles(azimuthDeg, zenithDeg);
    const behind = Math.min(Math.max(towards[2] / facts.behind, 0), 1);
    const metered = ballWeight(towards) + facts.metered * behind;
    const dimmed = facts.ball / (facts.fill * (1 + strength * metered));
    const before = strength * (1 - behind);
    // a disc's diameter is four spreads of a lobe
    const from = lobe(towards, (sizeDeg * Math.PI) / 180 / 4);
    const transport = this.transport(from);
    const lightOf = (ofFill: Float32Array, found: Float32Array, offset: number): Float32Array =>
      ofFill.map((share, i) => {
        const rest = (1 - behind) * share + (behind * found[i]!) / facts.ball;
        return dimmed * facts.fill * (rest + before * transport[2 * i + offset]!);
      });
    const diffuse = lightOf(occlusion, ofFound, 0);
    const glossy = lightOf(fillGloss, glossOfFound, 1);
    const after = this.levelOf(diffuse, glossy);
    const level = after.level.map((value, i) => value - this.before.level[i]!);
    let [sum, total] = [0, 0];
    this.face.forEach((weight, i) => {
      sum += weight * level[i]!;
      total += weight;
    });
    return {
      gain: this.continued(level),
      hollow: { after: this.continued(after.hollow), before: this.before.hollow },
      typical: sum / total,
      common: this.common(from, dimmed, before, behind),
      edge: { direction: towards, strength: (facts.rim * behind * strength) / (1 + strength * metered), spreadRad: from.spreadRad },
    };
  }

  /** Of luminances of shading and gloss, one number a point. */
  private levelOf(shading: Float32Array, glossy: Float32Array): Level {
    const { facts, face } = this.person;
    const base = facts.base * this.meanOnSkin(shading);
    const bounced = this.bounced(shading);
    const whole = this.summed(shading.map((value, i) => face[i]! * (value + bounced[i]! + facts.shine * glossy[i]!)));
    const level = this.sharp.of(whole).map((value) => Math.log(Math.max(value + base, 1e-9)));
    const own = this.sharp.of(this.summed(bounced.map((value, i) => face[i]! * value))).slice();
    const all = this.sharp.of(this.summed(shading.map((value, i) => face[i]! * (value + bounced[i]!))));
    return { level, hollow: own.map((value, i) => value / Math.max(all[i]!, 1e-9)) };
  }

  /** Of luminances of shading, what hollows receive of the person: skylight.portrait._bounce. */
  private bounced(shading: Float32Array): Float32Array {
    const { facts, occlusion } = this.person;
    const mean = this.around.of(this.summed(shading));
    return occlusion.map((share, i) => {
      // an even light of radiance 1 makes the ball as bright as pi
      const hidden = facts.albedo * Math.min(Math.max(1 - Math.PI * share, 0), 1);
      return (mean[this.cell[i]!]! * hidden) / (1 - hidden);
    });
  }

  /** skylight.portrait._gain.Surface.continued. */
  private continued(values: Float32Array): Float32Array {
    const near = this.filling.fill(this.reach.of(values.map((value, i) => value * this.face[i]!)));
    return values.map((value, i) => this.share[i]! * value + (1 - this.share[i]!) * near[i]!);
  }

  /** `max(0, 1 - |p - q|_1)` of skylight.portrait._relit.shared_light. */
  private common({ middle, spreadRad }: Lobe, dimmed: number, strength: number, behind: number): number {
    const { foundPower, facts } = this.person;
    // an even light of radiance 1 makes the ball as bright as pi
    const solid = solidAngles(2 * SHARED_ROWS, SHARED_ROWS);
    const power = foundPower.map((own, i) => {
      const even = solid[Math.floor(i / (2 * SHARED_ROWS))]! / Math.PI;
      return dimmed * facts.fill * ((1 - behind) * even + (behind * own) / facts.ball);
    });
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

  /** The points' values summed over the cells. */
  private summed(values: Float32Array): Float32Array {
    const picture = new Float32Array(this.grid.width * this.grid.height);
    for (let i = 0; i < this.cell.length; i++) picture[this.cell[i]!]! += values[i]!;
    return picture;
  }
}

const luminances = (values: Float32Array): Float32Array =>
  new Float32Array(values.length / 3).map((_, i) => luminance(values[3 * i]!, values[3 * i + 1]!, values[3 * i + 2]!));
