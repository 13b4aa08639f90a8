/** Triangles in a tree of boxes, to ask whether anything stands in a ray's way. */
export class Occluders {
  private readonly triangles: Float32Array; // a, b - a, c - a: nine numbers each
  private readonly bounds: Float64Array; // low, high: six numbers a node
  private readonly nodes: Int32Array; // first triangle and count, or -1 - right child and 0
  private readonly stack = new Int32Array(64);

  constructor(positions: ArrayLike<number>, indices: ArrayLike<number>) {
    const count = indices.length / 3;
    const corner = (triangle: number, which: number, axis: number) =>
      positions[3 * indices[3 * triangle + which]! + axis]!;
    const centres = new Float32Array(3 * count);
    for (let t = 0; t < count; t++) {
      for (let axis = 0; axis < 3; axis++) {
        centres[3 * t + axis] = (corner(t, 0, axis) + corner(t, 1, axis) + corner(t, 2, axis)) / 3;
      }
    }
    const order = Array.from({ length: count }, (_, t) => t);
    const bounds: number[] = [], nodes: number[] = [];
    split(order, 0, count);
    this.bounds = Float64Array.from(bounds);
    this.nodes = Int32Array.from(nodes);
    this.triangles = new Float32Array(9 * count);
    order.forEach((t, place) => {
      for (let axis = 0; axis < 3; axis++) {
        const a = corner(t, 0, axis);
        this.triangles[9 * place + axis] = a;
        this.triangles[9 * place + 3 + axis] = corner(t, 1, axis) - a;
        this.triangles[9 * place + 6 + axis] = corner(t, 2, axis) - a;
      }
    });

    /** Halves the triangles from..to by their centres, until few are left. */
    function split(order: number[], from: number, to: number): void {
      const node = nodes.length / 2;
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (let place = from; place < to; place++) {
        for (let which = 0; which < 3; which++) {
          for (let axis = 0; axis < 3; axis++) {
            const value = corner(order[place]!, which, axis);
            low[axis] = Math.min(low[axis]!, value);
            high[axis] = Math.max(high[axis]!, value);
          }
        }
      }
      bounds.push(...low, ...high);
      nodes.push(from, to - from);
      if (to - from <= 4) return;
      const extent = high.map((value, axis) => value - low[axis]!);
      const axis = extent.indexOf(Math.max(...extent));
      const part = order.slice(from, to);
      part.sort((a, b) => centres[3 * a + axis]! - centres[3 * b + axis]!);
      part.forEach((t, k) => (order[from + k] = t));
      const middle = (from + to) >> 1;
      split(order, from, middle);
      nodes[2 * node] = -1 - nodes.length / 2;
      nodes[2 * node + 1] = 0;
      split(order, middle, to);
    }
  }

  /** Whether the ray from o along d meets a triangle (from either side). */
  blocks(ox: number, oy: number, oz: number, dx: number, dy: number, dz: number): boolean {
    const { bounds, nodes, stack } = this;
    const ix = 1 / dx, iy = 1 / dy, iz = 1 / dz;
    stack[0] = 0;
    for (let depth = 1; depth > 0; ) {
      const node = stack[--depth]!;
      const b = 6 * node;
      const x0 = (bounds[b]! - ox) * ix, x1 = (bounds[b + 3]! - ox) * ix;
      const y0 = (bounds[b + 1]! - oy) * iy, y1 = (bounds[b + 4]! - oy) * iy;
      const z0 = (bounds[b + 2]! - oz) * iz, z1 = (bounds[b + 5]! - oz) * iz;
      const enter = Math.max(Math.min(x0, x1), Math.min(y0, y1), Math.min(z0, z1), 0);
      const leave = Math.min(Math.max(x0, x1), Math.max(y0, y1), Math.max(z0, z1));
      if (enter > leave) continue;
      const first = nodes[2 * node]!;
      if (first < 0) {
        stack[depth++] = -1 - first;
        stack[depth++] = node + 1;
        continue;
      }
      for (let t = first; t < first + nodes[2 * node + 1]!; t++) {
        if (this.meets(t, ox, oy, oz, dx, dy, dz)) return true;
      }
    }
    return false;
  }

  /** Möller and Trumbore, 1997. */
  private meets(
    t: number, ox: number, oy: number, oz: number, dx: number, dy: number, dz: number,
  ): boolean {
    const m = this.triangles, i = 9 * t;
    const ux = m[i + 3]!, uy = m[i + 4]!, uz = m[i + 5]!;
    const vx = m[i + 6]!, vy = m[i + 7]!, vz = m[i + 8]!;
    const px = dy * vz - dz * vy, py = dz * vx - dx * vz, pz = dx * vy - dy * vx;
    const determinant = ux * px + uy * py + uz * pz;
    if (determinant === 0) return false;
    const tx = ox - m[i]!, ty = oy - m[i + 1]!, tz = oz - m[i + 2]!;
    const u = (tx * px + ty * py + tz * pz) / determinant;
    if (u < 0 || u > 1) return false;
    const qx = ty * uz - tz * uy, qy = tz * ux - tx * uz, qz = tx * uy - ty * ux;
    const v = (dx * qx + dy * qy + dz * qz) / determinant;
    if (v < 0 || u + v > 1) return false;
    return (vx * qx + vy * qy + vz * qz) / determinant > 1e-4;
  }
}
