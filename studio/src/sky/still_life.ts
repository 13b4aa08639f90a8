import { BufferGeometry, Float32BufferAttribute, SphereGeometry, TorusKnotGeometry } from "three";
import type { Receivers } from "./transport";

/** A matte knot and a mirror ball on a ground, the knot's foot at y = 0. */
export interface StillLife {
  knot: BufferGeometry;
  ball: BufferGeometry;
  ground: BufferGeometry;
  receivers: Receivers;
}

const BALL = { centre: [1.02, 0.42, 0.42] as [number, number, number], radius: 0.42 };
/** The ground ends here; it has faded into the map's own ground by then. */
const GROUND_RADIUS = 7;

export function stillLife(): StillLife {
  const knot = new TorusKnotGeometry(0.58, 0.2, 132, 14, 2, 3);
  knot.computeBoundingBox();
  knot.translate(-0.35, -knot.boundingBox!.min.y, 0);
  const ball = new SphereGeometry(BALL.radius, 32, 20).translate(...BALL.centre);
  const ground = groundDisc();
  const both = (name: string) =>
    Float32Array.from([knot, ground].flatMap((one) => [...one.getAttribute(name)!.array]));
  const triangles = {
    positions: Float32Array.from(knot.getAttribute("position").array),
    indices: Uint32Array.from(knot.getIndex()!.array),
  };
  const receivers = { positions: both("position"), normals: both("normal"), triangles, ball: BALL };
  return { knot, ball, ground, receivers };
}

/** Rings that lie closer together where the shadows are. */
function groundDisc(): BufferGeometry {
  const rings = 28, spokes = 48;
  const positions: number[] = [], normals: number[] = [], farness: number[] = [], indices: number[] = [];
  for (let ring = 0; ring <= rings; ring++) {
    const radius = GROUND_RADIUS * (0.35 * (ring / rings) + 0.65 * (ring / rings) ** 3);
    const far = Math.max(0, (2 * radius) / GROUND_RADIUS - 1);
    for (let spoke = 0; spoke < spokes; spoke++) {
      const angle = (spoke / spokes) * 2 * Math.PI;
      positions.push(radius * Math.sin(angle), 0, -radius * Math.cos(angle));
      normals.push(0, 1, 0);
      farness.push(far);
      if (ring === rings) continue;
      const a = ring * spokes + spoke, b = ring * spokes + ((spoke + 1) % spokes);
      indices.push(a, b, a + spokes, b, b + spokes, a + spokes);
    }
  }
  const disc = new BufferGeometry();
  disc.setAttribute("position", new Float32BufferAttribute(positions, 3));
  disc.setAttribute("normal", new Float32BufferAttribute(normals, 3));
  disc.setAttribute("farness", new Float32BufferAttribute(farness, 1));
  disc.setIndex(indices);
  return disc;
}
