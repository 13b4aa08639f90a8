import {
  DepthTexture,
  DoubleSide,
  FloatType,
  MeshBasicMaterial,
  NearestFilter,
  OrthographicCamera,
  Vector3,
  Vector4,
  WebGLRenderTarget,
  type Scene,
  type Sphere,
  type WebGLRenderer,
} from "three";
import type { LightBatch } from "./lights";
import type { Plane } from "../plane";
import { GRAZING, LIGHTS, TILES } from "./shaders";

const TILE = 256;

/** Shadow maps of what casts shadows under a batch's lights: the tiles of one depth texture. */
export class ShadowMaps {
  readonly atlas: { value: DepthTexture };
  /** Centre and radius of the sphere that each tile just holds; radius 0 where nothing casts. */
  readonly bounds = { value: new Vector4() };
  /** The corners of each tile, cast on the plane: all shadow there lies between them. */
  readonly corners = { value: Array.from({ length: 4 * LIGHTS }, () => new Vector3()) };
  private readonly target: WebGLRenderTarget;
  private readonly depthOnly = new MeshBasicMaterial({ side: DoubleSide, colorWrite: false });
  private readonly camera = new OrthographicCamera();

  constructor(
    private readonly renderer: WebGLRenderer,
    private readonly lights: LightBatch,
  ) {
    const depthTexture = new DepthTexture(TILES * TILE, TILES * TILE, FloatType);
    depthTexture.minFilter = depthTexture.magFilter = NearestFilter;
    this.target = new WebGLRenderTarget(TILES * TILE, TILES * TILE, { depthTexture });
    this.atlas = { value: depthTexture };
  }

  /** Draws the scene's meshes, all within the sphere; null where nothing casts a shadow. */
  draw(scene: Scene, sphere: Sphere | null): void {
    const radius = sphere ? 1.02 * sphere.radius : 0;
    this.bounds.value.set(sphere?.center.x ?? 0, sphere?.center.y ?? 0, sphere?.center.z ?? 0, radius);
    if (!sphere) return;
    const { renderer, camera, target } = this;
    const { towards } = this.lights.uniforms;
    const before = { autoClear: renderer.autoClear, material: scene.overrideMaterial };
    renderer.autoClear = false;
    renderer.setRenderTarget(target);
    renderer.clear();
    scene.overrideMaterial = this.depthOnly;
    camera.left = camera.bottom = -radius;
    camera.right = camera.top = radius;
    camera.near = 0;
    camera.far = 4 * radius;
    camera.updateProjectionMatrix();
    for (let i = 0; i < LIGHTS; i++) {
      const to = towards.value[i]!;
      camera.up.set(0, Math.abs(to.y) < 0.9 ? 1 : 0, Math.abs(to.y) < 0.9 ? 0 : 1); // as LightBatch's sideways
      camera.position.copy(sphere.center).addScaledVector(to, 2 * radius);
      camera.lookAt(sphere.center);
      camera.updateMatrixWorld();
      target.viewport.set((i % TILES) * TILE, Math.floor(i / TILES) * TILE, TILE, TILE);
      renderer.setRenderTarget(target); // takes the viewport
      renderer.render(scene, camera);
    }
    target.viewport.set(0, 0, TILES * TILE, TILES * TILE);
    scene.overrideMaterial = before.material;
    renderer.autoClear = before.autoClear;
  }

  /** Sets the corners; those whose lights reach the plane are returned. */
  castOn({ normal, offset }: Plane): Vector3[] {
    const { towards, sideways } = this.lights.uniforms;
    const up = new Vector3(...normal);
    const { x, y, z, w: radius } = this.bounds.value;
    const reach: Vector3[] = [];
    for (let i = 0; i < LIGHTS; i++) {
      const to = towards.value[i]!;
      const across = sideways.value[i]!;
      const upwards = new Vector3().crossVectors(to, across);
      const slope = to.dot(up);
      CORNERS.forEach(([right, high], k) => {
        const corner = this.corners.value[4 * i + k]!.set(x, y, z);
        corner.addScaledVector(across, right * radius).addScaledVector(upwards, high * radius);
        corner.addScaledVector(to, (offset - corner.dot(up)) / Math.max(Number(GRAZING), slope));
        if (slope > Number(GRAZING)) reach.push(corner);
      });
    }
    return reach;
  }

  dispose(): void {
    this.target.depthTexture?.dispose();
    this.target.dispose();
    this.depthOnly.dispose();
  }
}

const CORNERS = [
  [-1, 1],
  [1, 1],
  [-1, -1],
  [1, -1],
] as const;
