/** A flat Radiance RGBE file of a map (height x width x 3): mantissas rounded, as io/hdr.py. */
export function radianceFile(map: Float32Array, height: number, width: number): Blob {
  const bytes = new Uint8Array(4 * height * width);
  for (let pixel = 0; pixel < height * width; pixel++) {
    const rgb = [0, 1, 2].map((c) => map[3 * pixel + c]!);
    const peak = Math.max(...rgb);
    if (peak < 1e-38) continue;
    let exponent = Math.floor(Math.log2(peak)) + 1;
    // a mantissa that would round up to 256 belongs to the next exponent
    if (Math.round(peak * 2 ** (8 - exponent)) >= 256) exponent += 1;
    rgb.forEach((value, c) => (bytes[4 * pixel + c] = Math.round(value * 2 ** (8 - exponent))));
    bytes[4 * pixel + 3] = exponent + 128;
  }
  const head = `#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y ${height} +X ${width}\n`;
  return new Blob([head, bytes], { type: "image/vnd.radiance" });
}
