import {
  CustomBlending,
  DoubleSide,
  GLSL3,
  InstancedBufferGeometry,
  Mesh,
  NoBlending,
  OneFactor,
  PlaneGeometry,
  ShaderMaterial,
  type WebGLRenderTarget,
} from "three";
import { DEPTH_FRAGMENT, DEPTH_VERTEX, SCREEN_VERTEX } from "./shaders";

export type Uniforms = Record<string, { value: unknown }>;

/** For a mesh that covers all of a target. */
export function fullScreen(fragmentShader: string, uniforms: Uniforms): ShaderMaterial {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: SCREEN_VERTEX,
    fragmentShader,
    uniforms,
    depthTest: false,
    depthWrite: false,
    blending: NoBlending,
  });
}

/** So many quads that the vertex shader places, their values summed in the target. */
export function summedQuads(count: number, vertexShader: string, fragmentShader: string, uniforms: Uniforms): Mesh {
  const geometry = new InstancedBufferGeometry().copy(new PlaneGeometry(2, 2) as never);
  geometry.instanceCount = count;
  const mesh = new Mesh(
    geometry,
    new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader,
      fragmentShader,
      uniforms,
      depthWrite: false,
      side: DoubleSide,
      blending: CustomBlending,
      blendSrc: OneFactor,
      blendDst: OneFactor,
    }),
  );
  mesh.frustumCulled = false;
  return mesh;
}

/** For what hides and is not seen. */
export function depthOnly(): ShaderMaterial {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: DEPTH_VERTEX,
    fragmentShader: DEPTH_FRAGMENT,
    side: DoubleSide,
    colorWrite: false,
  });
}

/** Sums over the batches: of the object, of what it keeps from the plane, and what people do. */
export const sumUniforms = (): Uniforms => ({
  objectSum: { value: null },
  blockedSum: { value: null },
  beforeSum: { value: null },
});

export function setSums({ uniforms }: ShaderMaterial, { textures }: WebGLRenderTarget): void {
  [uniforms.objectSum, uniforms.blockedSum, uniforms.beforeSum].forEach((sum, i) => {
    sum!.value = textures[i];
  });
}
