import {
  Color,
  DataTexture,
  DataUtils,
  DoubleSide,
  GLSL3,
  HalfFloatType,
  LinearFilter,
  LinearSRGBColorSpace,
  RepeatWrapping,
  RGBAFormat,
  ShaderMaterial,
  UnsignedByteType,
  type Material,
  type MeshStandardMaterial,
  type Texture,
} from "three";
import { SILVER_EXPONENT } from "../../shared/ball";
import { prefilter } from "../../shared/prefilter";
import type { RadianceMap } from "../../shared/radiance_map";
import { OBJECT_FRAGMENT, OBJECT_VERTEX } from "./shaders";

/** What a surface reflects: `gloss` is the head-on reflectance of what is no metal. */
export interface Surface {
  color: Color; // linear
  map: Texture | null;
  roughness: number;
  metalness: number;
  gloss: number;
  vertexColors: boolean;
}

const plain = { map: null, vertexColors: false };
export const FINISHES: Record<string, Surface> = {
  clay: { ...plain, color: new Color(0.42, 0.34, 0.27), roughness: 1, metalness: 0, gloss: 0 },
  matte: { ...plain, color: new Color(0.8, 0.8, 0.8), roughness: 1, metalness: 0, gloss: 0 },
  glazed: { ...plain, color: new Color(0.5, 0.07, 0.04), roughness: 0.15, metalness: 0, gloss: 0.04 },
  silver: { ...plain, color: new Color(0.95, 0.95, 0.95), roughness: 0.5, metalness: 1, gloss: 0 },
  mirror: { ...plain, color: new Color(0.95, 0.95, 0.95), roughness: 0, metalness: 1, gloss: 0 },
};

/** A model's own surface as its file describes it; .obj materials have no gloss that is physical. */
export function surfaceOf(material: Material): Surface {
  const from = material as Partial<MeshStandardMaterial> & Material;
  const physical = (from as MeshStandardMaterial).isMeshStandardMaterial === true;
  return {
    color: from.color?.clone() ?? new Color(0.8, 0.8, 0.8),
    map: from.map ?? null,
    roughness: physical ? (from.roughness ?? 1) : 1,
    metalness: physical ? (from.metalness ?? 0) : 0,
    gloss: physical ? 0.04 : 0,
    vertexColors: material.vertexColors,
  };
}

/** The maps that glossy surfaces show, as textures with the lowest row first. */
export class Reflections {
  readonly uniforms = {
    mirrorMap: { value: null as DataTexture | null },
    silverMap: { value: null as DataTexture | null },
    matteMap: { value: null as DataTexture | null },
  };

  setMap(map: RadianceMap): void {
    this.dispose();
    this.uniforms.mirrorMap.value = reflectionTexture(map);
    this.uniforms.silverMap.value = reflectionTexture(prefilter(map, SILVER_EXPONENT));
    this.uniforms.matteMap.value = reflectionTexture(prefilter(map, 1));
  }

  dispose(): void {
    for (const uniform of Object.values(this.uniforms)) uniform.value?.dispose();
  }
}

const white = new DataTexture(new Uint8Array([255, 255, 255, 255]), 1, 1, RGBAFormat, UnsignedByteType);
white.needsUpdate = true;

/** The material of a surface; `shared` are the uniforms of the lights and of the reflections. */
export function objectMaterial(surface: Surface, shared: Record<string, { value: unknown }>): ShaderMaterial {
  return new ShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: OBJECT_VERTEX,
    fragmentShader: OBJECT_FRAGMENT,
    side: DoubleSide,
    vertexColors: surface.vertexColors,
    uniforms: {
      ...shared,
      baseColor: { value: surface.color },
      baseMap: { value: surface.map ?? white },
      roughness: { value: surface.roughness },
      metalness: { value: surface.metalness },
      gloss: { value: surface.gloss },
    },
  });
}

const HALF_MOST = 65504;

function reflectionTexture({ width, height, data }: RadianceMap): DataTexture {
  const texels = new Uint16Array(4 * width * height);
  for (let row = 0; row < height; row++)
    for (let i = 0; i < width; i++) {
      const from = 3 * (row * width + i);
      const to = 4 * ((height - 1 - row) * width + i);
      for (let k = 0; k < 3; k++)
        texels[to + k] = DataUtils.toHalfFloat(Math.min(HALF_MOST, Math.max(0, data[from + k]!)));
    }
  const texture = new DataTexture(texels, width, height, RGBAFormat, HalfFloatType);
  texture.wrapS = RepeatWrapping;
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.colorSpace = LinearSRGBColorSpace;
  texture.needsUpdate = true;
  return texture;
}
