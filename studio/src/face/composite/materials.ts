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
  SRGBColorSpace,
  UnsignedByteType,
  type Material,
  type MeshStandardMaterial,
  type Texture,
} from "three";
import { SILVER_EXPONENT } from "../../shared/ball";
import { prefilter } from "../../shared/prefilter";
import type { RadianceMap } from "../../shared/radiance_map";
import { OBJECT_FRAGMENT, OBJECT_VERTEX } from "./render/shaders";

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
  stand: { ...plain, color: new Color(0.1, 0.1, 0.1), roughness: 0.5, metalness: 0, gloss: 0.04 },
  clay: { ...plain, color: new Color(0.42, 0.34, 0.27), roughness: 1, metalness: 0, gloss: 0 },
  chart: { ...plain, color: new Color(0.18, 0.18, 0.18), roughness: 1, metalness: 0, gloss: 0 }, // a film set's grey
  matte: { ...plain, color: new Color(0.8, 0.8, 0.8), roughness: 1, metalness: 0, gloss: 0 },
  glazed: { ...plain, color: new Color(0.5, 0.07, 0.04), roughness: 0.15, metalness: 0, gloss: 0.04 },
  silver: { ...plain, color: new Color(0.95, 0.95, 0.95), roughness: 0.5, metalness: 1, gloss: 0 },
  chrome: { ...plain, color: new Color(0.55, 0.556, 0.554), roughness: 0, metalness: 1, gloss: 0 }, // chromium, head-on
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

/** The mean of a surface's colour, linear: what its light has on average once it is reflected. */
export function albedoOf({ color, map }: Surface): Color {
  if (!map?.image) return color.clone();
  const small = document.createElement("canvas");
  small.width = small.height = 16;
  const context = small.getContext("2d")!;
  context.drawImage(map.image as CanvasImageSource, 0, 0, 16, 16);
  const texels = context.getImageData(0, 0, 16, 16).data;
  const mean = new Color(0, 0, 0);
  for (let i = 0; i < texels.length; i += 4)
    mean.add(new Color().setRGB(texels[i]! / 255, texels[i + 1]! / 255, texels[i + 2]! / 255, SRGBColorSpace));
  return mean.multiplyScalar(4 / texels.length).multiply(color);
}

/** The material of a surface; `shared` are the uniforms of the lights and of what is around it. */
export function objectMaterial(
  surface: Surface,
  shared: Record<string, { value: unknown }>,
  amongPeople = true,
): ShaderMaterial {
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
      amongPeople: { value: Number(amongPeople) },
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
