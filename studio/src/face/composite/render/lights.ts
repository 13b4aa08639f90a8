import { Vector3 } from "three";
import { lightStrata, type Lights } from "../../../shared/light_strata";
import type { RadianceMap } from "../../../shared/radiance_map";
import { GRAZING, LIGHTS } from "./shaders";

/** Batches until all light is in: 16 lights each, 1024 in all. */
export const BATCHES = 64;

/** The lights of a batch: every 64th piece of the map, each for 64. */
export class LightBatch {
  readonly uniforms = {
    towards: { value: Array.from({ length: LIGHTS }, () => new Vector3()) },
    /** Across the light's shadow map; its up is towards x sideways. */
    sideways: { value: Array.from({ length: LIGHTS }, () => new Vector3()) },
    flux: { value: Array.from({ length: LIGHTS }, () => new Vector3()) },
  };
  private lights: Lights | null = null;

  setMap(map: RadianceMap): void {
    this.lights = lightStrata(map, LIGHTS * BATCHES);
  }

  take(batch: number): void {
    const { directions, fluxes } = this.lights!;
    const { towards, sideways, flux } = this.uniforms;
    for (let i = 0; i < LIGHTS; i++) {
      const at = 3 * (i * BATCHES + reversed(batch));
      const to = towards.value[i]!.fromArray(directions, at);
      flux.value[i]!.fromArray(fluxes, at).multiplyScalar(BATCHES);
      sideways.value[i]!.set(0, Math.abs(to.y) < 0.9 ? 1 : 0, Math.abs(to.y) < 0.9 ? 0 : 1).cross(to).normalize();
    }
  }

  /** Adds the irradiance of an unshadowed plane: sum of flux x cosine. */
  addIrradiance(normal: Vector3, sum: Vector3): void {
    const { towards, flux } = this.uniforms;
    for (let i = 0; i < LIGHTS; i++) {
      const cosine = towards.value[i]!.dot(normal);
      if (cosine > Number(GRAZING)) sum.addScaledVector(flux.value[i]!, cosine);
    }
  }
}

/** The batch's six bits backwards: batches that follow each other lie far apart. */
function reversed(batch: number): number {
  let turned = 0;
  for (let bit = 1; bit < BATCHES; bit *= 2) turned = turned * 2 + (batch & bit ? 1 : 0);
  return turned;
}
