/** What a .glb claims, checked against its bytes before a reader believes it (glTF 2.0, sections 3.6 and 4.4). */

interface Claims {
  buffers?: { byteLength?: number; uri?: string }[];
  bufferViews?: { buffer?: number; byteOffset?: number; byteLength?: number; byteStride?: number }[];
  accessors?: { bufferView?: number; byteOffset?: number; componentType?: number; count?: number; type?: string }[];
  images?: { uri?: string }[];
  meshes?: { primitives?: { attributes?: { POSITION?: number } }[] }[];
  nodes?: { children?: number[]; mesh?: number }[];
  scenes?: { nodes?: number[] }[];
  extensionsRequired?: string[];
}

const GLTF = 0x46546c67;
const JSON_CHUNK = 0x4e4f534a;
const BYTES: Record<number, number> = { 5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4 };
const PARTS: Record<string, number> = { SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT2: 4, MAT3: 9, MAT4: 16 };
const COMPRESSIONS = ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"];
const LIES = "it is damaged, export it again";

/**
 * Throws an Error of one line where the file is no .glb, is cut off, claims more data than it has,
 * refers to other files, has more than so many vertices once all its nodes are drawn, nodes that
 * are not a tree, or a compression that the page does not read.
 */
export function checkGlb(bytes: ArrayBuffer, mostVertices: number): void {
  const view = new DataView(bytes);
  if (bytes.byteLength < 20 || view.getUint32(0, true) !== GLTF) throw new Error(`it is no .glb: ${LIES}`);
  const version = view.getUint32(4, true);
  if (version !== 2) throw new Error(`it is glTF ${version}: export it as glTF 2.0`);
  const said = view.getUint32(8, true);
  if (said !== bytes.byteLength)
    throw new Error(`it says that it has ${said} bytes, but has ${bytes.byteLength}: ${LIES}`);
  const length = view.getUint32(12, true);
  if (view.getUint32(16, true) !== JSON_CHUNK || 20 + length > bytes.byteLength)
    throw new Error(`its header reaches beyond its end: ${LIES}`);
  let claims: Claims;
  try {
    claims = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(new Uint8Array(bytes, 20, length))) as Claims;
  } catch {
    throw new Error(`its header is no JSON: ${LIES}`);
  }
  if (!claims || typeof claims !== "object") throw new Error(`its header is no JSON object: ${LIES}`);
  const binary = 20 + length + 8 <= bytes.byteLength ? view.getUint32(20 + length, true) : 0;
  if (20 + length + (binary ? 8 + binary : 0) > bytes.byteLength) throw new Error(`its data reach beyond its end: ${LIES}`);

  const packed = (claims.extensionsRequired ?? []).find((name) => COMPRESSIONS.includes(name));
  if (packed) throw new Error(`it is compressed (${packed}): export it without compression`);
  const outside = [...(claims.buffers ?? []), ...(claims.images ?? [])].find(
    ({ uri }) => uri !== undefined && !String(uri).startsWith("data:"),
  );
  if (outside) throw new Error("it refers to other files: export it as one .glb with everything in it");
  checkData(claims, binary, mostVertices);
  checkNodes(claims, mostVertices);
}

function checkData({ buffers = [], bufferViews = [], accessors = [] }: Claims, binary: number, mostVertices: number): void {
  const whole = (value: unknown): number => {
    const number = value ?? 0;
    if (!Number.isSafeInteger(number) || (number as number) < 0) throw new Error(`a length in its header is no number: ${LIES}`);
    return number as number;
  };
  buffers.forEach(({ byteLength, uri }) => {
    const most = uri === undefined ? binary : uri.length;
    if (whole(byteLength) > most) throw new Error(`it claims ${byteLength} bytes of data, but has ${most}: ${LIES}`);
  });
  bufferViews.forEach(({ buffer, byteOffset, byteLength }) => {
    const most = buffers[buffer ?? 0]?.byteLength ?? 0;
    if (whole(byteOffset) + whole(byteLength) > most) throw new Error(`a part of its data reaches beyond their end: ${LIES}`);
  });
  accessors.forEach((one) => {
    const count = whole(one.count);
    const element = (BYTES[one.componentType ?? 0] ?? 1) * (PARTS[one.type ?? ""] ?? 1);
    if (one.bufferView === undefined) {
      // zeros, as many as it says, with some of them replaced
      if (count > mostVertices) throw new Error(`it claims ${count} values that it has no data for: ${LIES}`);
      return;
    }
    const from = bufferViews[one.bufferView];
    const stride = Math.max(element, whole(from?.byteStride));
    const needed = whole(one.byteOffset) + (count ? (count - 1) * stride + element : 0);
    const most = from ? whole(from.byteLength) : 0;
    if (needed > most) throw new Error(`it claims ${count} values where it has data for fewer: ${LIES}`);
  });
}

function checkNodes({ accessors = [], meshes = [], nodes = [], scenes = [] }: Claims, mostVertices: number): void {
  const children = nodes.flatMap((node) => node.children ?? []);
  const roots = scenes.flatMap((scene) => scene.nodes ?? []);
  if (new Set(children).size < children.length || roots.some((root) => children.includes(root)))
    throw new Error(`its nodes are not a tree: ${LIES}`);
  let vertices = 0;
  for (const { mesh } of nodes)
    for (const { attributes } of (mesh === undefined ? undefined : meshes[mesh]?.primitives) ?? [])
      vertices += accessors[attributes?.POSITION ?? -1]?.count ?? 0;
  if (vertices > mostVertices)
    throw new Error(`it has ${vertices} vertices, more than ${mostVertices / 1e6} million: export it with fewer triangles`);
}
