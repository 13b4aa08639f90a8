import type { EstimateResult } from "../api";
import type { RadianceMap } from "../shared/radiance_map";

/** A map as base64 of Radiance's codes: red, green, blue and the exponent of all three. */
export interface StoredMap {
  width: number;
  height: number;
  rgbe: string;
}
/** What `skylight export viewer` writes into the page. */
export interface ViewerData {
  version: string;
  /** The photograph's name, and its picture: base64 of a JPEG of this size. */
  name: string;
  photo: { width: number; height: number; jpeg: string };
  probe: StoredMap;
  /** Where the sun or main lamp may stand; null where none was seen. */
  posterior: StoredMap | null;
  /** A model to begin with, base64 of its file. */
  object: { name: string; content: string } | null;
  /** The camera is that of the picture in the page. */
  result: EstimateResult;
}

/** The data of this page; null in the template, which has none. */
export function readData(): ViewerData | null {
  const text = document.getElementById("estimate")?.textContent;
  return text ? (JSON.parse(text) as ViewerData) : null;
}

export const bytesOf = (base64: string): Uint8Array<ArrayBuffer> =>
  Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));

/** L = code 2^(e - 136), as Radiance has it; three.js' reader makes it 256 / 255 of that. */
export function decodeMap({ width, height, rgbe }: StoredMap): RadianceMap {
  const codes = bytesOf(rgbe);
  const data = new Float32Array(3 * width * height);
  for (let from = 0, to = 0; to < data.length; from += 4, to += 3) {
    const scale = 2 ** (codes[from + 3]! - 136);
    for (let k = 0; k < 3; k++) data[to + k] = codes[from + k]! * scale;
  }
  return { width, height, data };
}
