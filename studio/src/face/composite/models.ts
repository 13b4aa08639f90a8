import {
  Box3,
  BoxGeometry,
  CylinderGeometry,
  Group,
  Mesh,
  Object3D,
  SphereGeometry,
  TorusKnotGeometry,
  Vector3,
  type BufferGeometry,
} from "three";
import { TeapotGeometry } from "three/addons/geometries/TeapotGeometry.js";
import { FINISHES, type Surface } from "./materials";
import type { Extent, Stand } from "./placement";

/** Centre and radius of a sphere that stands for a part of a model, in units of its size. */
export type ModelSphere = readonly [x: number, y: number, z: number, radius: number];

/** Something to be placed: its foot is the origin, +Y up, its size is 1. */
export interface Model {
  object: Object3D;
  /** What its size is: a label. */
  measure: string;
  /** Where it is held or on a table. */
  extent: Extent;
  /** Whether it has surfaces of its own. */
  isDressed: boolean;
  /** Whether the spheres are the model itself, not only about its size. */
  areBalls: boolean;
  spheres: readonly ModelSphere[];
}

const HEIGHT = "Height of the object";
const BALL = 0.11; // metres; a head is 23 cm high
const APART = 1.1; // from ball to ball of the pair, diameters
const TRAY = { radius: 0.55, thickness: 0.03 }; // of a held model's width, and of its size
const ROD = { radius: 0.003, length: 3 }; // metres

/** What stands ready to be placed; each made when it is first chosen. */
const SHAPES: Record<string, { title: string; usual: number; make: () => BufferGeometry }> = {
  teapot: { title: "Teapot", usual: 0.13, make: () => new TeapotGeometry(1, 7) },
  ball: { title: "Ball", usual: BALL, make: () => ballGeometry() },
  knot: { title: "Knot", usual: 0.16, make: () => new TorusKnotGeometry(1, 0.34, 128, 20) },
  box: { title: "Box", usual: 0.1, make: () => new BoxGeometry(1, 1, 1) },
};
const BALLS = "balls";
export const MODELS: readonly { value: string; title: string }[] = [
  { value: BALLS, title: "Diffuse and chrome balls" },
  ...Object.entries(SHAPES).map(([value, { title }]) => ({ value, title })),
];

export function ownModel(name: string, kind: Stand["kind"]): Model {
  if (name === BALLS) return pairOfBalls(kind);
  const { make, usual } = SHAPES[name]!;
  const object = standing(new Group().add(new Mesh(make())));
  return { ...measured(object, usual), areBalls: name === "ball", isDressed: false };
}

/** As on a film set: one over the other on a rod, beside each other on a plane. */
function pairOfBalls(kind: Stand["kind"]): Model {
  const places: Vector3[] =
    kind === "held"
      ? [new Vector3(0, 0.5, 0), new Vector3(0, 0.5 + APART, 0)]
      : [new Vector3(-0.6, 0.5, 0), new Vector3(0.6, 0.5, 0)];
  const object = new Group();
  const surfaces: Surface[] = [FINISHES.chart!, FINISHES.chrome!];
  places.forEach((place, i) => {
    const ball = new Mesh(ballGeometry());
    ball.geometry.scale(0.5, 0.5, 0.5).translate(place.x, place.y, place.z);
    ball.userData.surfaces = [surfaces[i]!];
    object.add(ball);
  });
  return {
    object,
    measure: "Diameter of the balls",
    extent: kind === "held" ? { width: 1, height: 1 + APART, usual: BALL } : { width: 2.2, height: 1, usual: BALL },
    isDressed: true,
    areBalls: true,
    spheres: places.map(({ x, y, z }) => [x, y, z, 0.5] as const),
  };
}

const ballGeometry = (): BufferGeometry => new SphereGeometry(1, 64, 32);

/** Moved and scaled to height 1 (flat things: to width 2), its foot in the middle of y = 0. */
export function standing(model: Group): Object3D {
  const bounds = new Box3().setFromObject(model, true);
  const size = bounds.getSize(new Vector3());
  const scale = 1 / Math.max(size.y, size.x / 2, size.z / 2);
  if (!Number.isFinite(scale)) throw new Error("it has no size");
  const middle = bounds.getCenter(new Vector3());
  model.position.set(-middle.x * scale, -bounds.min.y * scale, -middle.z * scale);
  model.scale.setScalar(scale);
  return new Group().add(model);
}

/** A standing object with the sphere that stands for it: of its box's volume, no lower than its foot. */
export function measured(object: Object3D, usual: number): Omit<Model, "areBalls" | "isDressed"> {
  object.updateMatrixWorld(true);
  const bounds = new Box3().setFromObject(object, true);
  const size = bounds.getSize(new Vector3());
  const radius = Math.min(Math.cbrt((3 * size.x * size.y * size.z) / (4 * Math.PI)), size.y / 2);
  const extent = { width: 2 * TRAY.radius * Math.max(size.x, size.z), height: size.y + TRAY.thickness, usual };
  return { object, measure: HEIGHT, extent, spheres: [[0, size.y / 2, 0, radius]] };
}

/** A tray under a model that is held, of the model's units. */
export function trayFor({ extent }: Model): Mesh {
  const { thickness } = TRAY;
  const disc = new CylinderGeometry(extent.width / 2, extent.width / 2, thickness, 64);
  return new Mesh(disc.translate(0, -0.51 * thickness, 0));
}

/** The rod that holds what is held, from the origin down; metres. */
export function rod(): Mesh {
  return new Mesh(new CylinderGeometry(ROD.radius, ROD.radius, ROD.length, 16).translate(0, -ROD.length / 2, 0));
}
