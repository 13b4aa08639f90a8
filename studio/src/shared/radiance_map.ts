import { FloatType } from "three";
import { EXRLoader } from "three/addons/loaders/EXRLoader.js";
import { HDRLoader } from "three/addons/loaders/HDRLoader.js";
import { getBytes } from "../api";
import { solidAngles } from "./frame";

/** Radiance over all directions, linear Rec.709: a lat-long map in skylight's convention, RGB. */
export interface RadianceMap {
  width: number;
  height: number;
  data: Float32Array;
}

/** Reads the bytes of an .exr or .hdr as they are: no turn, no scale. */
export function decodeRadianceMap(bytes: ArrayBuffer, name: string): RadianceMap {
  const isExr = name.toLowerCase().endsWith(".exr");
  const loader = isExr ? new EXRLoader() : new HDRLoader();
  loader.type = FloatType;
  const { width, height, data } = loader.parse(bytes) as {
    width: number;
    height: number;
    data: Float32Array;
  };
  const rgb = new Float32Array(3 * width * height);
  const channels = data.length / (width * height);
  for (let row = 0; row < height; row++) {
    const from = isExr ? height - 1 - row : row; // three's EXR reader has the lowest row first
    for (let column = 0; column < width; column++)
      for (let c = 0; c < 3; c++) {
        const value = data[(from * width + column) * channels + (channels < 3 ? 0 : c)]!;
        rgb[(row * width + column) * 3 + c] = value;
      }
  }
  return { width, height, data: rgb };
}

export async function loadRadianceMap(url: string): Promise<RadianceMap> {
  return decodeRadianceMap(await getBytes(url), new URL(url, location.href).pathname);
}

/** A map with each channel times its gain. */
export function tinted(map: RadianceMap, gains: readonly [number, number, number]): RadianceMap {
  return { ...map, data: map.data.map((value, i) => value * gains[i % 3]!) };
}

export const luminance = (r: number, g: number, b: number): number =>
  0.2126 * r + 0.7152 * g + 0.0722 * b;

/** The luminance below which the given share of a map's pixels lie; its maximum where that is 0. */
export function whiteLevel({ data }: RadianceMap, quantile = 0.98): number {
  const level = new Float32Array(data.length / 3);
  for (let i = 0; i < level.length; i++)
    level[i] = luminance(data[3 * i]!, data[3 * i + 1]!, data[3 * i + 2]!);
  level.sort();
  return level[Math.ceil(quantile * level.length) - 1] || level[level.length - 1] || 1;
}

/**
 * A function that looks a map up between its pixels: bilinear, round in azimuth, held at the poles.
 * It writes into `out` at `at`, so that a picture of many look-ups makes no garbage.
 */
export function sampler(
  { width, height, data }: RadianceMap,
): (column: number, row: number, out: Float32Array, at: number) => void {
  return (column, row, out, at) => {
    const r = Math.min(Math.max(row, 0), height - 1);
    const r0 = Math.floor(r);
    const c0 = Math.floor(column);
    const fr = r - r0;
    const fc = column - c0;
    const left = ((c0 % width) + width) % width;
    const right = (left + 1) % width;
    const upper = r0 * width;
    const lower = Math.min(r0 + 1, height - 1) * width;
    for (let k = 0; k < 3; k++)
      out[at + k] =
        (1 - fr) * ((1 - fc) * data[3 * (upper + left) + k]! + fc * data[3 * (upper + right) + k]!) +
        fr * ((1 - fc) * data[3 * (lower + left) + k]! + fc * data[3 * (lower + right) + k]!);
  };
}

/**
 * The mean over each block of pixels by solid angle, so that the map's width is at most `width` and
 * its integral stays.
 */
export function shrink(map: RadianceMap, width: number): RadianceMap {
  const by = Math.ceil(map.width / width);
  if (by <= 1 || map.width % by || map.height % by) return map;
  const small = { width: map.width / by, height: map.height / by };
  const data = new Float32Array(3 * small.width * small.height);
  const omega = solidAngles(map.width, map.height);
  const blocks = solidAngles(small.width, small.height);
  for (let row = 0; row < map.height; row++) {
    const share = omega[row]! / blocks[Math.floor(row / by)]!;
    for (let column = 0; column < map.width; column++) {
      const to = 3 * (Math.floor(row / by) * small.width + Math.floor(column / by));
      const from = 3 * (row * map.width + column);
      for (let c = 0; c < 3; c++) data[to + c]! += map.data[from + c]! * share;
    }
  }
  return { ...small, data };
}
