import { Group, Mesh, type BufferGeometry, type Material, type Object3D } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import { checkGlb } from "./glb_check";
import { surfaceOf } from "./materials";
import { measured, standing, type Model } from "./models";

const USUAL = 0.13; // metres: files do not tell their unit reliably
/** Larger files are refused before they are read. */
const MOST_MB = 200;
/** Of all meshes together; each is drawn a thousand times for its shadows. */
export const MOST_VERTICES = 3_000_000;

/**
 * Reads a user's .obj or .glb, here in the page. Throws an Error whose line says what is wrong.
 * Vertices are put in place once and for all, so that only meshes of the model's frame remain.
 */
export async function readModel(file: File): Promise<Model> {
  try {
    if (file.size > MOST_MB * 1e6)
      throw new Error(`it is larger than ${MOST_MB} MB: export it with fewer triangles or smaller textures`);
    const object = standing(inPlace(await parsed(file)));
    return { ...measured(object, USUAL), isDressed: true, areBalls: false };
  } catch (error) {
    throw new Error(`${file.name} cannot be read: ${reason(error)}`);
  }
}

function reason(error: unknown): string {
  if (error instanceof RangeError) return "it is too large for this browser's memory";
  if (error instanceof TypeError) return "it is damaged, export it again";
  return error instanceof Error ? error.message : String(error);
}

async function parsed(file: File): Promise<Object3D> {
  const name = file.name.toLowerCase();
  if (name.endsWith(".obj")) return new OBJLoader().parse(await file.text());
  if (!name.endsWith(".glb")) throw new Error("it ends neither in .obj nor in .glb");
  const bytes = await file.arrayBuffer();
  checkGlb(bytes, MOST_VERTICES);
  return (await new GLTFLoader().parseAsync(bytes, "")).scene;
}

function inPlace(read: Object3D): Group {
  const model = new Group();
  let vertices = 0;
  read.updateMatrixWorld(true);
  read.traverse((part) => {
    if (!(part instanceof Mesh)) return;
    const geometry = (part.geometry as BufferGeometry).clone();
    const count = geometry.getAttribute("position")?.count ?? 0;
    if (count === 0) return;
    vertices += count;
    if (vertices > MOST_VERTICES)
      throw new Error(`it has more than ${MOST_VERTICES / 1e6} million vertices: export it with fewer triangles`);
    geometry.applyMatrix4(part.matrixWorld);
    if (!geometry.getAttribute("normal")) geometry.computeVertexNormals();
    const materials = (Array.isArray(part.material) ? part.material : [part.material]) as Material[];
    const mesh = new Mesh(geometry);
    mesh.userData.surfaces = materials.map(surfaceOf); // in the order of the geometry's groups
    model.add(mesh);
  });
  if (model.children.length === 0) throw new Error("it holds no triangles");
  return model;
}
