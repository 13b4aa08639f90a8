import { Matrix4, Vector3, Vector4, type Color } from "three";
import type { Model } from "../models";
import { largestFrom, type People } from "../people";
import type { Stand } from "../placement";
import { OTHERS, OWN } from "./shaders";

const NONE = new Vector4(0, 0, 0, 0);
const BLACK = new Vector3(0, 0, 0);

/** What the shaders know of the plane, and of the spheres that stand for the object and for people. */
export class Surroundings {
  readonly uniforms = {
    plane: { value: new Vector4() },
    own: { value: Array.from({ length: OWN }, () => new Vector4()) },
    ownAlbedo: { value: Array.from({ length: OWN }, () => new Vector3()) },
    others: { value: Array.from({ length: OTHERS }, () => new Vector4()) },
    otherAlbedo: { value: Array.from({ length: OTHERS }, () => new Vector3()) },
    balls: { value: 0 },
  };

  /** `placed` takes the model to its place; `albedos` are those of its spheres, or one for all. */
  set(model: Model, albedos: readonly Color[], placed: Matrix4, stand: Stand, people: People): void {
    const { plane, own, ownAlbedo, others, otherAlbedo, balls } = this.uniforms;
    if (stand.kind === "plane") plane.value.set(...stand.plane.normal, stand.plane.offset);
    else plane.value.set(0, 0, 0, 0);
    const size = placed.getMaxScaleOnAxis();
    own.value.forEach((sphere, k) => {
      const [x, y, z, radius] = model.spheres[k] ?? [0, 0, 0, 0];
      const centre = new Vector3(x, y, z).applyMatrix4(placed);
      sphere.set(centre.x, centre.y, centre.z, radius * size);
      const { r, g, b } = albedos[k] ?? albedos[0]!;
      ownAlbedo.value[k]!.set(r, g, b);
    });
    // balls are seen in each other; what is no ball is not like its sphere
    const count = (balls.value = model.areBalls ? model.spheres.length : 0);
    const around = [
      ...own.value.slice(0, count).map((sphere, k) => [sphere, ownAlbedo.value[k]!] as const),
      ...largestFrom(own.value[0]!, people.spheres, OTHERS - count).map(
        (k) => [people.spheres[k]!, people.albedos[k]!] as const,
      ),
    ];
    others.value.forEach((sphere, k) => {
      const [there, albedo] = around[k] ?? [NONE, BLACK];
      sphere.copy(there);
      otherAlbedo.value[k]!.copy(albedo);
    });
  }
}
