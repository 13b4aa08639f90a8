import { BufferGeometry, Color, Float32BufferAttribute, Group, LineBasicMaterial, LineLoop, Mesh, MeshBasicMaterial, Vector3 } from "three";
import { mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";

/** One cell of a partitions probe; with a light also what its face shows and tells of. */
export interface Cell {
  number: number;
  solid_angle_sr: number;
  direction: [number, number, number];
  /** Convex spherical polygons, unit corners in order. */
  outline: [number, number, number][][];
  /** sRGB-free: linear, 0 to 1. */
  colour: [number, number, number];
  shading?: [number, number, number];
  radiance?: [number, number, number];
}

/** Of a border from corner to corner. */
const SIDES = 2 ** 4;
const SPLITS = 4;

/** The cells as coloured patches of a sphere with their borders drawn. */
export function cellSphere(cells: Cell[], colourOf: (cell: Cell) => readonly [number, number, number]): Group {
  const group = new Group();
  for (const cell of cells) {
    const material = new MeshBasicMaterial({ color: new Color(...colourOf(cell)) });
    for (const outline of cell.outline) {
      const corners = outline.map((corner) => new Vector3(...corner));
      group.add(new Mesh(patch(corners), material), border(corners));
    }
  }
  return group;
}

/** Triangles from the polygon's middle to its sides, split and pushed out to the sphere. */
function patch(corners: Vector3[]): BufferGeometry {
  const middle = corners.reduce((sum, one) => sum.add(one), new Vector3()).normalize();
  let triangles = corners.map((corner, i) => [middle, corner, corners[(i + 1) % corners.length]!]);
  for (let split = 0; split < SPLITS; split++) {
    triangles = triangles.flatMap(([a, b, c]) => {
      const [ab, bc, ca] = [[a, b], [b, c], [c, a]].map(([p, q]) => p!.clone().add(q!).normalize());
      return [[a!, ab!, ca!], [ab!, b!, bc!], [ca!, bc!, c!], [ab!, bc!, ca!]];
    });
  }
  const geometry = new BufferGeometry();
  const positions = triangles.flat().flatMap((corner) => corner!.toArray());
  geometry.setAttribute("position", new Float32BufferAttribute(positions, 3));
  return mergeVertices(geometry);
}

function border(corners: Vector3[]): LineLoop {
  const points: Vector3[] = [];
  corners.forEach((corner, i) => {
    const next = corners[(i + 1) % corners.length]!;
    for (let k = 0; k < SIDES; k++) points.push(corner.clone().lerp(next, k / SIDES).setLength(1.003));
  });
  return new LineLoop(new BufferGeometry().setFromPoints(points), new LineBasicMaterial({ color: 0x111418 }));
}
