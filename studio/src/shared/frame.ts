/**
 * Directions as skylight has them: right-handed, +Y up, the camera looks along -Z, +X is the
 * picture's right. Azimuth from -Z towards +X, zenith angle from +Y. A lat-long map has the zenith
 * in row 0 and -Z in its centre. Rows and columns are continuous; pixel centres sit at integers.
 */
export type Vec3 = readonly [x: number, y: number, z: number];

const RADIAN = Math.PI / 180;

export function fromAngles(azimuthDeg: number, zenithDeg: number): Vec3 {
  const a = azimuthDeg * RADIAN;
  const z = zenithDeg * RADIAN;
  return [Math.sin(z) * Math.sin(a), Math.cos(z), -Math.sin(z) * Math.cos(a)];
}

export function toAngles([x, y, z]: Vec3): { azimuth_deg: number; zenith_deg: number } {
  return {
    azimuth_deg: Math.atan2(x, -z + 0) / RADIAN,
    zenith_deg: Math.atan2(Math.hypot(x, z), y) / RADIAN,
  };
}

export function toPixel([x, y, z]: Vec3, width: number, height: number): [column: number, row: number] {
  return [
    (Math.atan2(x, -z) / (2 * Math.PI) + 0.5) * width - 0.5,
    (Math.atan2(Math.hypot(x, z), y) / Math.PI) * height - 0.5,
  ];
}

export function fromPixel(column: number, row: number, width: number, height: number): Vec3 {
  return fromAngles(((column + 0.5) / width - 0.5) * 360, ((row + 0.5) / height) * 180);
}

/** Solid angle of one pixel of each row: 2 pi / w (cos z0 - cos z1), exact. */
export function solidAngles(width: number, height: number): Float64Array {
  const edge = (row: number): number => Math.cos((Math.PI * row) / height);
  return Float64Array.from({ length: height }, (_, row) => ((2 * Math.PI) / width) * (edge(row) - edge(row + 1)));
}

/** A direction as its photographer would point: "behind, left, high". */
export function inWords(azimuthDeg: number, zenithDeg: number): string {
  if (zenithDeg < 15) return "overhead";
  const turned = Math.abs(azimuthDeg);
  const depth = turned < 67.5 ? "ahead" : turned > 112.5 ? "behind the camera" : "";
  const side = turned < 22.5 || turned > 157.5 ? "" : azimuthDeg < 0 ? "left" : "right";
  const height = zenithDeg < 40 ? "high" : zenithDeg > 70 ? "low" : "half high";
  return [depth, side, height].filter(Boolean).join(", ");
}

/**
 * Where light comes from, as skylight's verdicts say it: "from behind on the left, high". Left and
 * right are the picture's, and behind is behind the person.
 */
export function whereFrom(azimuthDeg: number, zenithDeg: number): string {
  if (zenithDeg < 20) return "from above";
  if (zenithDeg > 160) return "from below";
  const [x, y, z] = fromAngles(azimuthDeg, zenithDeg);
  if (z > Math.cos(12 * RADIAN)) return "from the camera";
  const around = Math.abs(Math.atan2(x, z)) / RADIAN; // from where the camera stands
  const side = x < 0 ? "left" : "right";
  const where =
    around < 25
      ? "from the front"
      : around < 65
        ? `from the front ${side}`
        : around < 115
          ? `from the ${side}`
          : `from behind${around < 155 ? ` on the ${side}` : ""}`;
  const elevation = Math.asin(y) / RADIAN;
  const height = elevation >= 45 ? "high" : elevation >= 15 ? "" : elevation >= -15 ? "low" : "from below";
  return height ? `${where}, ${height}` : where;
}
