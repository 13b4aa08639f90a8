/** A safetensors file: 8 bytes with the length of a JSON header, the header, the numbers. */
export interface Tensors {
  floats: (name: string) => Float32Array;
  bytes: (name: string) => Uint8Array;
  integers: (name: string) => Int32Array;
  shape: (name: string) => number[];
  /** The text that skylight wrote beside the tensors. */
  text: (name: string) => string;
}

interface Entry {
  dtype: string;
  shape: number[];
  data_offsets: [number, number];
}

export function readTensors(file: ArrayBuffer): Tensors {
  const length = Number(new DataView(file).getBigUint64(0, true));
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(file, 8, length))) as {
    [name: string]: Entry;
  } & { __metadata__: { skylight: string } };
  const texts = JSON.parse(header.__metadata__.skylight) as Record<string, string>;
  const part = (name: string, dtype: string): ArrayBuffer => {
    const entry = header[name];
    if (entry?.dtype !== dtype) throw new Error(`the file's ${name} is ${entry?.dtype ?? "missing"}, not ${dtype}`);
    const [from, to] = entry.data_offsets;
    return file.slice(8 + length + from, 8 + length + to);
  };
  return {
    floats: (name) => new Float32Array(part(name, "F32")),
    bytes: (name) => new Uint8Array(part(name, "U8")),
    integers: (name) => new Int32Array(part(name, "I32")),
    shape: (name) => header[name]!.shape,
    text: (name) => texts[name]!,
  };
}
