import {
  Box3,
  Matrix4,
  NearestFilter,
  OrthographicCamera,
  DepthTexture,
  FloatType,
  MeshBasicMaterial,
  DoubleSide,
  Scene,
  Sphere,
  Vector3,
  WebGLRenderTarget,
  type Object3D,
  type WebGLRenderer,
} from "three";
import { lightStrata, type Lights } from "../../shared/light_strata";
import type { RadianceMap } from "../../shared/radiance_map";
import { GRAZING, LIGHTS, TILES } from "./shaders";

/** Batches until all light is in: 16 lights each, 1024 in all. */
export const BATCHES = 64;
const TILE = 256;

/** The lights of a batch, with the shadow maps of an object under them. */
export class ShadowedLights {
  readonly uniforms = {
    towards: { value: Array.from({ length: LIGHTS }, () => new Vector3()) },
    flux: { value: Array.from({ length: LIGHTS }, () => new Vector3()) },
    shadowMatrix: { value: Array.from({ length: LIGHTS }, () => new Matrix4()) },
    atlas: { value: null as DepthTexture | null },
  };
  /** The corners of each light's tile, cast on the ground: all its shadow lies between them. */
  readonly corners = Array.from({ length: 4 * LIGHTS }, () => new Vector3());
  /** Irradiance of unshadowed ground under the batch: sum of flux x cosine. */
  readonly onGround = new Vector3();
  private lights: Lights | null = null;
  private readonly atlas: WebGLRenderTarget;
  private readonly depthOnly = new MeshBasicMaterial({ side: DoubleSide, colorWrite: false });
  private readonly camera = new OrthographicCamera();

  constructor(private readonly renderer: WebGLRenderer) {
    const depthTexture = new DepthTexture(TILES * TILE, TILES * TILE, FloatType);
    depthTexture.minFilter = depthTexture.magFilter = NearestFilter;
    this.atlas = new WebGLRenderTarget(TILES * TILE, TILES * TILE, { depthTexture });
    this.uniforms.atlas.value = depthTexture;
  }

  setMap(map: RadianceMap): void {
    this.lights = lightStrata(map, LIGHTS * BATCHES);
  }

  /**
   * Takes the batch's lights, every 64th piece of the map, each for 64, and renders the shadow
   * maps: each tile just holds the object's bounding sphere, so what falls outside is lit.
   */
  prepare(batch: number, scene: Scene, object: Object3D): void {
    const { directions, fluxes } = this.lights!;
    const bounds = new Box3().setFromObject(object).getBoundingSphere(new Sphere());
    const radius = bounds.radius * 1.02;
    this.onGround.set(0, 0, 0);
    const { renderer, camera, atlas } = this;
    const before = renderer.autoClear;
    renderer.autoClear = false;
    renderer.setRenderTarget(atlas);
    renderer.clear();
    scene.overrideMaterial = this.depthOnly;
    for (let i = 0; i < LIGHTS; i++) {
      const at = 3 * (i * BATCHES + reversed(batch));
      const towards = this.uniforms.towards.value[i]!.fromArray(directions, at);
      const flux = this.uniforms.flux.value[i]!.fromArray(fluxes, at).multiplyScalar(BATCHES);
      if (towards.y > Number(GRAZING)) this.onGround.addScaledVector(flux, towards.y);
      camera.left = camera.bottom = -radius;
      camera.right = camera.top = radius;
      camera.near = 0;
      camera.far = 4 * radius;
      camera.up.set(0, Math.abs(towards.y) < 0.9 ? 1 : 0, Math.abs(towards.y) < 0.9 ? 0 : 1);
      camera.position.copy(bounds.center).addScaledVector(towards, 2 * radius);
      camera.lookAt(bounds.center);
      camera.updateMatrixWorld();
      camera.updateProjectionMatrix();
      this.uniforms.shadowMatrix.value[i]!.copy(TO_UNIT)
        .multiply(camera.projectionMatrix)
        .multiply(camera.matrixWorldInverse);
      CORNERS.forEach(([x, y], k) => {
        const corner = this.corners[4 * i + k]!.set(x * radius, y * radius, -2 * radius);
        corner.applyMatrix4(camera.matrixWorld);
        corner.addScaledVector(towards, -corner.y / Math.max(Number(GRAZING), towards.y));
      });
      atlas.viewport.set((i % TILES) * TILE, Math.floor(i / TILES) * TILE, TILE, TILE);
      renderer.setRenderTarget(atlas); // takes the viewport
      renderer.render(scene, camera);
    }
    atlas.viewport.set(0, 0, TILES * TILE, TILES * TILE);
    scene.overrideMaterial = null;
    renderer.autoClear = before;
  }

  /** The corners of the tiles whose lights reach the ground. */
  cornersOnGround(): Vector3[] {
    return this.corners.filter((_, k) => this.uniforms.towards.value[k >> 2]!.y > Number(GRAZING));
  }

  dispose(): void {
    this.atlas.depthTexture?.dispose();
    this.atlas.dispose();
    this.depthOnly.dispose();
  }
}

const CORNERS = [
  [-1, 1],
  [1, 1],
  [-1, -1],
  [1, -1],
] as const;
const TO_UNIT = new Matrix4().set(0.5, 0, 0, 0.5, 0, 0.5, 0, 0.5, 0, 0, 0.5, 0.5, 0, 0, 0, 1);

/** The batch's six bits backwards: batches that follow each other lie far apart. */
function reversed(batch: number): number {
  let turned = 0;
  for (let bit = 1; bit < BATCHES; bit *= 2) turned = turned * 2 + (batch & bit ? 1 : 0);
  return turned;
}
