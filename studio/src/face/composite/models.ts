import {
  Box3,
  BoxGeometry,
  Group,
  Mesh,
  Object3D,
  SphereGeometry,
  TorusKnotGeometry,
  Vector3,
  type BufferGeometry,
  type Material,
} from "three";
import { TeapotGeometry } from "three/addons/geometries/TeapotGeometry.js";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { OBJLoader } from "three/addons/loaders/OBJLoader.js";
import { surfaceOf } from "./materials";

/** What stands ready to be placed; each made when it is first chosen. */
export const MODELS: Record<string, { title: string; make: () => BufferGeometry }> = {
  teapot: { title: "Teapot", make: () => new TeapotGeometry(1, 7) },
  ball: { title: "Ball", make: () => new SphereGeometry(1, 64, 32) },
  knot: { title: "Knot", make: () => new TorusKnotGeometry(1, 0.34, 128, 20) },
  box: { title: "Box", make: () => new BoxGeometry(1, 1, 1) },
};

export function ownModel(name: string): Object3D {
  return standing(new Group().add(new Mesh(MODELS[name]!.make())));
}

/**
 * Reads a user's .obj or .glb, here in the page. Throws an Error whose line says what is wrong.
 * Vertices are put in place once and for all, so that only meshes of the model's frame remain.
 */
export async function readModel(file: File): Promise<Object3D> {
  const name = file.name.toLowerCase();
  const model = new Group();
  let read: Object3D;
  try {
    if (name.endsWith(".obj")) read = new OBJLoader().parse(await file.text());
    else if (name.endsWith(".glb")) read = (await new GLTFLoader().parseAsync(await file.arrayBuffer(), "")).scene;
    else throw new Error("it ends neither in .obj nor in .glb");
  } catch (error) {
    throw new Error(`${file.name} cannot be read: ${error instanceof Error ? error.message : error}`);
  }
  read.updateMatrixWorld(true);
  read.traverse((part) => {
    if (!(part instanceof Mesh)) return;
    const geometry = (part.geometry as BufferGeometry).clone();
    geometry.applyMatrix4(part.matrixWorld);
    if (!geometry.getAttribute("normal")) geometry.computeVertexNormals();
    const materials = (Array.isArray(part.material) ? part.material : [part.material]) as Material[];
    const mesh = new Mesh(geometry);
    mesh.userData.surfaces = materials.map(surfaceOf); // in the order of the geometry's groups
    model.add(mesh);
  });
  if (model.children.length === 0) throw new Error(`${file.name} holds no triangles`);
  return standing(model);
}

/** Moved and scaled to height 1 (flat things: to width 2), its foot in the middle of y = 0. */
function standing(model: Group): Object3D {
  const bounds = new Box3().setFromObject(model, true);
  const size = bounds.getSize(new Vector3());
  const scale = 1 / Math.max(size.y, size.x / 2, size.z / 2);
  if (!Number.isFinite(scale)) throw new Error("the model has no size");
  const middle = bounds.getCenter(new Vector3());
  model.position.set(-middle.x * scale, -bounds.min.y * scale, -middle.z * scale);
  model.scale.setScalar(scale);
  return new Group().add(model);
}
