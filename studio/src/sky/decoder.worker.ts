import { env, InferenceSession, Tensor } from "onnxruntime-web/wasm";
import { groundIrradiance, turned, withGround, type Rgb } from "./latlong";
import { sunOf, withoutSun, type Sun } from "./sun";
import { Transport, type Receivers } from "./transport";

// Decoding and transport run here, beside the page, which only draws: the two take turns on a
// machine with one core and overlap on any other.

export interface Start {
  kind: "start";
  decoder: ArrayBuffer;
  receivers: Receivers;
}

/** A sky to show: latent, where its sun stands (radians), and the ground's albedo. */
export interface Wish {
  kind: "sky";
  latent: Float32Array;
  azimuth: number;
  albedo: Rgb;
}

export interface Sky {
  kind: "sky";
  wish: Wish;
  /** 64 x 128 x 3, the ground included, in the decoder's relative radiance. */
  map: Float32Array;
  /** At the receivers, from everything but the sun. */
  irradiance: Float32Array;
  sun: Sun;
  /** Of level ground in the open. */
  groundIrradiance: Rgb;
}

export type Answer = { kind: "ready" } | { kind: "failed"; message: string } | Sky;

const send = (answer: Answer, transfer: Transferable[] = []) => postMessage(answer, { transfer });

let session: InferenceSession;
let transport: Transport;
let latest: { latent: string; sky: Float32Array; rest: Float32Array; sun: Sun } | undefined;

async function start({ decoder, receivers }: Start): Promise<void> {
  env.wasm.numThreads = 1; // the other cores draw meanwhile
  session = await InferenceSession.create(decoder, { executionProviders: ["wasm"] });
  transport = new Transport(receivers);
  send({ kind: "ready" });
}

async function show(wish: Wish): Promise<void> {
  const latent = wish.latent.join();
  if (latest?.latent !== latent) {
    const input = new Tensor("float32", wish.latent, [1, wish.latent.length]);
    const { radiance } = await session.run({ latent: input });
    const sky = radiance!.data as Float32Array;
    const sun = sunOf(wish.latent);
    latest = { latent, sky, rest: withoutSun(sky, sun), sun };
  }
  const sky = turned(latest.sky, wish.azimuth);
  const onGround = groundIrradiance(sky);
  const ground = onGround.map((e, c) => (wish.albedo[c]! / Math.PI) * e);
  const map = withGround(sky, ground);
  const irradiance = transport.irradiance(turned(latest.rest, wish.azimuth), ground);
  send({ kind: "sky", wish, map, irradiance, sun: latest.sun, groundIrradiance: onGround }, [
    map.buffer,
    irradiance.buffer,
  ]);
}

addEventListener("message", ({ data }: MessageEvent<Start | Wish>) => {
  (data.kind === "start" ? start(data) : show(data)).catch((error: unknown) =>
    send({ kind: "failed", message: error instanceof Error ? error.message : String(error) }),
  );
});
