import { BufferAttribute, BufferGeometry } from "three";
import type { EstimateResult } from "../api";
import type { Person } from "../face/composite/people";
import type { RadianceMap } from "../shared/radiance_map";

/** A map as base64 of Radiance's codes: red, green, blue and the exponent of all three. */
export interface StoredMap {
  width: number;
  height: number;
  rgbe: string;
}
/** A head: base64 of codes of 16 bits, `scale` metres each, from the eyes, and of its triangles. */
export interface StoredHead {
  scale: number;
  vertices: string;
  faces: string;
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
  /** One for each of the result's faces; null for those of other photographs. */
  heads: (StoredHead | null)[];
  /** A model to begin with, base64 of its file. */
  object: { name: string; content: string } | null;
  /** Camera and white balance are those of the picture in the page. */
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

/** Those in the photograph whose heads are known. */
export function peopleOf({ heads, result }: ViewerData): Person[] {
  return result.faces.flatMap(({ eyes, forward, albedo }, i) => {
    const stored = heads[i];
    if (!stored) return [];
    const codes = new Int16Array(bytesOf(stored.vertices).buffer);
    const places = Float32Array.from(codes, (code, k) => eyes[k % 3]! + stored.scale * code);
    const head = new BufferGeometry()
      .setAttribute("position", new BufferAttribute(places, 3))
      .setIndex(new BufferAttribute(new Uint16Array(bytesOf(stored.faces).buffer), 1));
    return [{ head, eyes, forward, albedo }];
  });
}
