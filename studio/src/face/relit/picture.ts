import { EDIT } from "../../shared/edit";
import type { Facts, Person } from "./person";
import type { Grid, KeyLight, Lit } from "./key_light";

const CORNERS = `#version 300 es
void main() {
  gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0);
}`;

// The formulas of skylight.portrait._relit, and of skylight.portrait._files.shown
const PIXEL = `#version 300 es
precision highp float;
const int STEPS = 16;
uniform highp sampler2D photo, marks, gain, outline, pale, reflecting;
uniform vec2 size, from, extent, crop; // of the picture; and where the person's grid, and its crop, are in it
uniform vec2 drawn; // pixels of the canvas
uniform vec2 most, otherMost;
uniform vec3 lacks[STEPS], hue, across;
uniform vec3 lamp, shine; // behind the sitter
uniform vec2 sent; // of surfaces and of hair
uniform float edge, spread, lit, stray, mostStrand, soonLit, soon;
uniform float typical, doubted, other, range, knee;
uniform vec2 room; // and these, of skylight.portrait._room
uniform float darkest, veil, bend, edgeOfWhite, over;
uniform float before; // the share of the width, from the left, that is as it was photographed
out vec4 color;

${EDIT}
vec3 encoded(vec3 light) {
  return mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));
}
// GLSL's own overflows for large numbers on some machines
vec3 tanh_(vec3 x) {
  vec3 e = exp(-2.0 * clamp(x, -20.0, 20.0));
  return (1.0 - e) / (1.0 + e);
}
float soon_(float change) {
  float away = 2.0 * abs(change) / soon;
  return 1.0 - (1.0 + away) * exp(-away);
}
void main() {
  vec2 at = vec2(gl_FragCoord.x, drawn.y - gl_FragCoord.y) * size / drawn;
  vec4 seen = texture(photo, at / size); // linear
  vec3 p = seen.rgb, light = p;
  // branches: where no graphics card is, most of the time goes into looking textures up
  if (at.x >= before * size.x && seen.a > 0.0) {
    vec3 scene = unedited(p);
    vec4 leans = texture(outline, (at - from) / crop); // how bright it is around, last
    vec4 whiter = texture(pale, (at - from) / crop);
    vec3 sends = texture(reflecting, (at - from) / crop).rgb;
    vec4 mark = texture(marks, at / size);
    float hidden = range * (2.0 * mark.r - 1.0);
    float base = darkest * (1.0 - mark.g);
    vec3 change = texture(gain, (at - from) / extent).rgb; // of level; and light from the face, after and before
    float more = change.r + other * hidden - typical;
    float free = (-base - typical - room.x) / room.y;
    free = room.y * (max(free, 0.0) + log(1.0 + exp(-abs(free))));
    vec2 limit = mix(otherMost, vec2(most.x - min(typical, 0.0), most.y), mark.b);
    limit.x = max(limit.x * free / pow(pow(limit.x, 4.0) + pow(free, 4.0), 0.25), 1e-4);
    float slope = pow(1.0 + pow(bend / limit.x, 4.0), -0.125), less = min(more, 0.0);
    less -= (1.0 - slope) * bend * (exp(less / bend) - 1.0);
    vec2 both = limit * tanh_(vec3(vec2(slope * max(more, 0.0), less) / limit, 0.0)).xy;
    float level = typical + doubted * (both.x + both.y);
    float usual = max(typical, 0.0);
    if (level > usual) level = usual + log(1.0 + (exp(level - usual) - 1.0) * (1.0 - (1.0 - mark.b) * min(veil * exp(-base), 1.0)));
    float lost = (1.0 - mark.b) * clamp(1.0 - (1.0 - exp(base)) / edgeOfWhite, 0.0, 1.0);
    if (level < 0.0) level = min(level + over * lost, 0.0);
    float place = mark.g * float(STEPS - 1);
    int step = min(int(place), STEPS - 2);
    vec3 tint = leans.b * soon_(level - typical) * mix(lacks[step], lacks[step + 1], place - float(step));
    tint += mark.b * doubted * (log(1.0 + change.g * (hue - 1.0)) - log(1.0 + change.b * (hue - 1.0)));
    tint += soon_(min(level - typical, 0.0)) * whiter.rgb;
    tint -= soon_(min(level, 0.0)) * whiter.a * across;
    float cosine = dot(leans.rg, lamp.xy) + sqrt(max(1.0 - dot(leans.rg, leans.rg), 0.0)) * lamp.z;
    float radius = 2.0 * spread, risen = clamp(cosine + radius, 0.0, 2.0 * radius);
    float shown = max(dot(scene, vec3(0.2126, 0.7152, 0.0722)), 0.0);
    float own = shown / (shown + stray);
    float received = risen * risen / (4.0 * radius) + max(cosine - radius, 0.0);
    vec2 lights = mark.a * edge * own * sends.rg * vec2(received, received / (received + soonLit));
    lights.y *= min(shown / (leans.a + stray), mostStrand);
    vec3 behind = dot(lights, sent) * scene + (lights.x + lights.y) * sends.b * lit * shine;
    vec3 person = scene * mix(vec3(1.0), exp(tint + level), seen.a) + seen.a * max(1.0 - exp(base + level), 0.0) * behind;
    light = max(edited(person) + p - edited(scene), 0.0);
    vec3 k = clamp(p, knee, 1.0 - 1e-6);
    if (any(greaterThan(light, k))) light = min(light, k) + (1.0 - k) * tanh_(max(light - k, 0.0) / (1.0 - k));
  }
  color = vec4(encoded(clamp(light, 0.0, 1.0)), 1.0);
}`;

const SETTLED_MS = 250;
const SLOW_MS = 40;
const FAST_MS = 20;

/**
 * Draws a person in a new light into a canvas, which gets the picture's size once the light has
 * stayed for a moment; until then as many pixels as the screen shows of it, or fewer where that is
 * slow.
 */
export class RelitPicture {
  private readonly gl: WebGL2RenderingContext;
  private readonly uniforms = new Map<string, WebGLUniformLocation>();
  private readonly program: WebGLProgram;
  private readonly wide: boolean; // numbers of 32 bits, half as wide ones elsewhere
  private readonly size: { width: number; height: number };
  private readonly box: Box; // all else stays as the photograph has it
  private scale = 0; // pixels of the canvas a pixel of the picture, along an axis
  private detail = 1; // pixels of the canvas a pixel of the screen, while the light changes
  private settling = 0;
  private before = 0;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    { picture, marks, outline, pale, reflecting, facts }: Person,
    private readonly light: KeyLight,
  ) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser offers no WebGL 2, so the person cannot be relit here");
    this.gl = gl;
    this.size = picture;
    this.box = box(picture);
    // half as wide numbers are slower where no graphics card is
    this.wide = gl.getExtension("OES_texture_float_linear") !== null;
    this.program = program(gl);
    gl.useProgram(this.program);
    const number = (name: string, ...values: number[]): void => {
      const place = this.uniform(name);
      if (values.length === 1) gl.uniform1f(place, values[0]!);
      else gl.uniform2f(place, values[0]!, values[1]!);
    };
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    ["photo", "marks", "gain", "outline", "pale", "reflecting"].forEach((name, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
      gl.uniform1i(this.uniform(name), unit);
    });
    gl.activeTexture(gl.TEXTURE0);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.SRGB8_ALPHA8, picture.width, picture.height, 0, gl.RGBA, gl.UNSIGNED_BYTE, picture.codes);
    gl.activeTexture(gl.TEXTURE1);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, picture.width, picture.height, 0, gl.RGBA, gl.UNSIGNED_BYTE, marks);
    const across = picture.width / facts.size[0];
    const down = picture.height / facts.size[1];
    number("size", picture.width, picture.height);
    const { left, top, width, height, step } = light.grid;
    number("from", left * across, top * down);
    number("extent", width * step * across, height * step * down);
    const [, , columns, rows] = facts.crop;
    number("crop", columns * across, rows * down);
    gl.activeTexture(gl.TEXTURE3);
    gl.texImage2D(gl.TEXTURE_2D, 0, this.wide ? gl.RGBA32F : gl.RGBA16F, columns, rows, 0, gl.RGBA, gl.FLOAT, outline);
    gl.activeTexture(gl.TEXTURE4);
    gl.texImage2D(gl.TEXTURE_2D, 0, this.wide ? gl.RGBA32F : gl.RGBA16F, columns, rows, 0, gl.RGBA, gl.FLOAT, pale);
    gl.activeTexture(gl.TEXTURE5);
    gl.texImage2D(gl.TEXTURE_2D, 0, this.wide ? gl.RGB32F : gl.RGB16F, columns, rows, 0, gl.RGB, gl.FLOAT, reflecting);
    this.setConstants(facts, number);
    this.paint(1, 1);
  }

  draw({ gain, hollow, typical, common, edge }: Lit): void {
    const { canvas, size } = this;
    this.upload(this.light.grid, gain, hollow.after, hollow.before);
    this.gl.uniform1f(this.uniform("typical"), typical);
    this.gl.uniform1f(this.uniform("other"), 1 - common);
    this.gl.uniform3f(this.uniform("lamp"), ...edge.direction);
    this.gl.uniform1f(this.uniform("edge"), edge.strength);
    this.gl.uniform1f(this.uniform("spread"), edge.spreadRad);
    const begun = performance.now();
    this.paint(this.before, Math.min(1, (this.detail * canvas.clientWidth * devicePixelRatio) / size.width || 1));
    requestAnimationFrame(() => {
      const took = performance.now() - begun;
      if (took > SLOW_MS) this.detail = Math.max(0.5, 0.8 * this.detail);
      if (took < FAST_MS) this.detail = Math.min(1, 1.25 * this.detail);
    });
    clearTimeout(this.settling);
    this.settling = window.setTimeout(() => this.show(this.before), SETTLED_MS);
  }

  /** The last picture at its own size, that share of it from the left as it was photographed. */
  show(before: number): void {
    clearTimeout(this.settling);
    this.before = before;
    this.paint(before, 1);
  }

  dispose(): void {
    clearTimeout(this.settling);
    this.gl.getExtension("WEBGL_lose_context")?.loseContext();
  }

  private paint(before: number, scale: number): void {
    const { gl, canvas, size, box } = this;
    const isCleared = scale !== this.scale;
    if (isCleared) {
      this.scale = scale;
      canvas.width = Math.round(scale * size.width);
      canvas.height = Math.round(scale * size.height);
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.scissor(
        Math.floor(scale * box.left),
        Math.floor(scale * (size.height - box.top - box.height)),
        Math.ceil(scale * box.width) + 2,
        Math.ceil(scale * box.height) + 2,
      );
      gl.uniform2f(this.uniform("drawn"), canvas.width, canvas.height);
      gl.activeTexture(gl.TEXTURE0);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, scale < 1 ? gl.LINEAR : gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, scale < 1 ? gl.LINEAR : gl.NEAREST);
      gl.disable(gl.SCISSOR_TEST);
    } else gl.enable(gl.SCISSOR_TEST);
    gl.uniform1f(this.uniform("before"), before);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  private setConstants(facts: Facts, number: (name: string, ...values: number[]) => void): void {
    number("most", ...facts.most);
    number("doubted", facts.doubted);
    number("range", facts.unseen);
    number("darkest", facts.darkest);
    number("veil", facts.veil);
    number("room", ...facts.room);
    number("bend", facts.bend);
    number("otherMost", ...facts.other_most);
    number("lit", facts.lit);
    this.gl.uniform3f(this.uniform("shine"), ...facts.lamp_shine);
    number("stray", facts.stray);
    number("mostStrand", facts.most_strand);
    number("sent", ...facts.sent);
    number("soonLit", facts.soon_lit);
    number("soon", facts.soon);
    this.gl.uniform3fv(this.uniform("lacks"), facts.lacks.flat());
    this.gl.uniform3f(this.uniform("hue"), ...facts.hue);
    this.gl.uniform3f(this.uniform("across"), ...facts.across);
    number("edgeOfWhite", facts.edge_of_white);
    number("over", facts.over);
    number("knee", facts.knee);
    const { saturation, contrast, pivot } = facts.edit;
    this.gl.uniform3f(this.uniform("edit"), saturation, contrast, pivot);
  }

  private upload({ width, height }: Grid, ...channels: [Float32Array, Float32Array, Float32Array]): void {
    const { gl } = this;
    const values = new Float32Array(3 * width * height);
    channels.forEach((channel, k) => channel.forEach((value, i) => (values[3 * i + k] = value)));
    gl.activeTexture(gl.TEXTURE2);
    gl.texImage2D(gl.TEXTURE_2D, 0, this.wide ? gl.RGB32F : gl.RGB16F, width, height, 0, gl.RGB, gl.FLOAT, values);
  }

  private uniform(name: string): WebGLUniformLocation {
    let place = this.uniforms.get(name);
    if (!place) this.uniforms.set(name, (place = this.gl.getUniformLocation(this.program, name)!));
    return place;
  }
}

interface Box {
  left: number;
  top: number;
  width: number;
  height: number;
}

/** The rectangle that holds all of the matte. */
function box({ width, height, codes }: Person["picture"]): Box {
  let [left, top, right, foot] = [width, height, 0, 0];
  for (let row = 0, at = 3; row < height; row++)
    for (let column = 0; column < width; column++, at += 4) {
      if (codes[at] === 0) continue;
      left = Math.min(left, column);
      right = Math.max(right, column + 1);
      top = Math.min(top, row);
      foot = row + 1;
    }
  return { left, top, width: Math.max(0, right - left), height: Math.max(0, foot - top) };
}

function program(gl: WebGL2RenderingContext): WebGLProgram {
  const made = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, CORNERS], [gl.FRAGMENT_SHADER, PIXEL]] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  if (!gl.getProgramParameter(made, gl.LINK_STATUS)) throw new Error("this browser's WebGL cannot relight the person");
  return made;
}
