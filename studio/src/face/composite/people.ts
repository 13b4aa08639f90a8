import {
  CapsuleGeometry,
  Group,
  Matrix4,
  Mesh,
  Vector3,
  Vector4,
  type BufferGeometry,
} from "three";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import type { Vec3 } from "../../shared/frame";
import { times } from "./plane";

/** Somebody in the photo, in the camera's frame, metres. */
export interface Person {
  /** The fitted head, as mesh.obj has it: bare, without hair. */
  head: BufferGeometry;
  /** Mid-head at the height of the eyes: the origin of the head's own frame. */
  eyes: Vec3;
  /** Where the face looks, a unit vector. */
  forward: Vec3;
  /** Of the skin, linear. */
  albedo: Vec3;
}

/** How high the eyes of somebody who stands are over the ground, metres. */
export const EYE_HEIGHT = 1.6;

// In the head's own frame (metres, the face looks along +Z): spheres that stand for the head where
// exactness does not count, in mirrors and for the light that skin reflects: skull, jaw and neck. Seen
// from beside the face they cover the directions that the average head covers, but for a tenth.
export const HEAD_SPHERES: readonly (readonly [x: number, y: number, z: number, radius: number])[] = [
  [0, 0.01, -0.03, 0.1],
  [0, -0.058, 0.007, 0.067],
  [0, -0.13, -0.063, 0.066],
];
/** What the three cover together, as part of the sum: the light of each is as much less. */
export const TOGETHER = 0.77;
// Shoulders, and what is below them, turned with the face but upright: a capsule across and one down
// to the ground, of the widths and heights of a middle-sized adult (Gordon et al. 2014: 0.45 m over
// the upper arms, the shoulders' top 0.2 m below the eyes).
const SHOULDERS = { below: 0.28, behind: 0.03, radius: 0.08, width: 0.45 };
const TRUNK = { top: 0.24, radius: 0.14 };
const CLOTHES = 0.2; // their albedo, which is not known

/** What the people in a photo do to an object: shade it, hide it, show in it. */
export class People {
  readonly heads = new Group();
  readonly shoulders = new Group();
  readonly trunks = new Group();
  /** Centre and radius of the spheres that stand for them, in the order of the people; their albedos. */
  readonly spheres: Vector4[] = [];
  readonly albedos: Vector3[] = [];

  constructor(people: readonly Person[]) {
    for (const { head, eyes, forward, albedo } of people) {
      this.heads.add(new Mesh(head));
      const upright = new Matrix4().makeBasis(...axes(new Vector3(forward[0], 0, forward[2]), new Vector3(0, 1, 0)));
      const place = new Matrix4().makeTranslation(...eyes).multiply(upright);
      const { below, behind, radius, width } = SHOULDERS;
      const across = new CapsuleGeometry(radius, width - 2 * radius, 6, 16).rotateZ(Math.PI / 2);
      across.translate(0, -below, -behind);
      const down = EYE_HEIGHT - TRUNK.top;
      const trunk = new CapsuleGeometry(TRUNK.radius, down - 2 * TRUNK.radius, 6, 16);
      trunk.translate(0, -TRUNK.top - down / 2, -behind);
      this.shoulders.add(new Mesh(across.applyMatrix4(place)));
      this.trunks.add(new Mesh(trunk.applyMatrix4(place)));

      const turned = new Matrix4()
        .makeTranslation(...eyes)
        .multiply(new Matrix4().makeBasis(...axes(new Vector3(...forward), new Vector3(0, 1, 0))));
      const add = (at: Matrix4, x: number, y: number, z: number, r: number, shade: Vec3): void => {
        const { x: right, y: up, z: back } = new Vector3(x, y, z).applyMatrix4(at);
        this.spheres.push(new Vector4(right, up, back, r));
        this.albedos.push(new Vector3(...shade));
      };
      for (const [x, y, z, r] of HEAD_SPHERES) add(turned, x, y, z, r, times(albedo, TOGETHER));
      for (const x of [-0.13, 0.13]) add(place, x, -below, -behind, 0.1, [CLOTHES, CLOTHES, CLOTHES]);
    }
  }
}

/** Which spheres, at most so many, look largest from a place: the largest first. */
export function largestFrom(
  place: { x: number; y: number; z: number },
  spheres: readonly { x: number; y: number; z: number; w: number }[],
  most: number,
): number[] {
  const far = spheres.map(({ x, y, z, w }) => Math.hypot(x - place.x, y - place.y, z - place.z) / w);
  return [...spheres.keys()].sort((a, b) => far[a]! - far[b]!).slice(0, most);
}

/** +X, +Y and +Z of something that looks along `forward`. */
function axes(forward: Vector3, up: Vector3): [Vector3, Vector3, Vector3] {
  const ahead = forward.clone().normalize();
  const right = new Vector3().crossVectors(up, ahead).normalize();
  return [right, new Vector3().crossVectors(ahead, right), ahead];
}

/** The geometry of a mesh.obj. */
export function headMesh(obj: string): BufferGeometry {
  const mesh = new OBJLoader().parse(obj).children[0];
  if (!(mesh instanceof Mesh)) throw new Error("the mesh of the head holds no triangles");
  return mesh.geometry as BufferGeometry;
}
