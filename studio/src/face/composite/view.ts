import {
  CustomBlending,
  DoubleSide,
  FloatType,
  GLSL3,
  Group,
  HalfFloatType,
  InstancedBufferGeometry,
  Mesh,
  NearestFilter,
  NoBlending,
  NoColorSpace,
  OneFactor,
  OrthographicCamera,
  PerspectiveCamera,
  PlaneGeometry,
  Scene,
  ShaderMaterial,
  Texture,
  Vector3,
  WebGLRenderer,
  WebGLRenderTarget,
  type Object3D,
  type TextureDataType,
} from "three";
import type { RadianceMap } from "../../shared/radiance_map";
import { boundOnScreen, cornersOf, NEAR } from "./bounds";
import { BATCHES, ShadowedLights } from "./lights";
import { FINISHES, objectMaterial, Reflections, type Surface } from "./materials";
import {
  ADD_FRAGMENT,
  GROUND_FRAGMENT,
  GROUND_VERTEX,
  LIGHTS,
  PHOTO_FRAGMENT,
  SCREEN_VERTEX,
} from "./shaders";

/** A level pinhole camera; lengths in pixels of the photo. */
export interface Pinhole {
  focal_px: number;
  width: number;
  height: number;
  principal: [x: number, y: number];
}
/** Metres: x to the right of the camera, z in front of it, and the ground's depth below it. */
export interface Placement {
  x: number;
  z: number;
  size: number;
  turnDeg: number;
  cameraHeight: number;
}

/**
 * A photo with an object in it, lit by a map. Light comes in batches of 16 shadowed lights, one
 * batch a frame, averaged in float targets until all 1024 are in; whatever moves starts it anew.
 */
export class CompositeView {
  private readonly renderer: WebGLRenderer;
  private readonly lights: ShadowedLights;
  private readonly reflections = new Reflections();
  private readonly objectScene = new Scene();
  private readonly groundScene = new Scene();
  private readonly holder = new Group();
  private readonly camera = new PerspectiveCamera();
  private readonly screenCamera = new OrthographicCamera(-1, 1, 1, -1, -1, 1);
  private readonly screen = new Mesh(new PlaneGeometry(2, 2));
  private readonly screenScene = new Scene();
  private readonly objectTarget: WebGLRenderTarget;
  private readonly groundTarget: WebGLRenderTarget;
  private sums: [WebGLRenderTarget, WebGLRenderTarget];
  private readonly add: ShaderMaterial;
  private readonly show: ShaderMaterial;
  private readonly bias = { value: 0 };
  private readonly sink = { value: 0 };
  private placement: Placement = { x: 0, z: 2, size: 0.3, turnDeg: 0, cameraHeight: 1 };
  private hasLight = false;
  private batch = 0;
  private asked = 0;

  /** Throws where the browser has no WebGL 2 with float targets. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    photo: TexImageSource,
    private readonly pinhole: Pinhole,
    private readonly progress: (batches: number, all: number) => void,
  ) {
    const { width, height } = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: false, preserveDrawingBuffer: true });
    if (!this.renderer.extensions.has("EXT_color_buffer_float")) {
      this.renderer.dispose();
      throw new Error("no float targets");
    }
    this.renderer.setPixelRatio(1);
    this.renderer.setSize(width, height, false);
    this.lights = new ShadowedLights(this.renderer);

    const target = (count = 1, type: TextureDataType = FloatType): WebGLRenderTarget =>
      new WebGLRenderTarget(width, height, {
        type,
        minFilter: NearestFilter,
        magFilter: NearestFilter,
        depthBuffer: count === 1,
        count,
      });
    this.objectTarget = target();
    this.groundTarget = target(1, HalfFloatType); // blended into, which full floats may not offer
    this.sums = [target(2), target(2)];

    const full = (fragmentShader: string, uniforms: Record<string, { value: unknown }>): ShaderMaterial =>
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: SCREEN_VERTEX,
        fragmentShader,
        uniforms,
        depthTest: false,
        depthWrite: false,
        blending: NoBlending,
      });
    this.add = full(ADD_FRAGMENT, {
      objectSum: { value: null },
      groundSum: { value: null },
      object: { value: this.objectTarget.texture },
      ground: { value: this.groundTarget.texture },
    });
    const picture = new Texture(photo);
    picture.colorSpace = NoColorSpace; // decoded in the shader, so that untouched pixels stay as they are
    picture.generateMipmaps = false;
    picture.needsUpdate = true;
    this.show = full(PHOTO_FRAGMENT, {
      objectSum: { value: null },
      groundSum: { value: null },
      photo: { value: picture },
      unshadowed: { value: new Vector3() },
      batches: { value: 0 },
    });
    const quads = new InstancedBufferGeometry().copy(new PlaneGeometry(2, 2) as never);
    quads.instanceCount = LIGHTS;
    const ground = new Mesh(
      quads,
      new ShaderMaterial({
        glslVersion: GLSL3,
        vertexShader: GROUND_VERTEX,
        fragmentShader: GROUND_FRAGMENT,
        uniforms: { ...this.lights.uniforms, corners: { value: this.lights.corners }, sink: this.sink },
        depthTest: false,
        depthWrite: false,
        side: DoubleSide,
        blending: CustomBlending,
        blendSrc: OneFactor,
        blendDst: OneFactor,
      }),
    );
    ground.frustumCulled = false;
    this.groundScene.add(ground);
    this.objectScene.add(this.holder);
    this.screenScene.add(this.screen);
    this.restart();
  }

  setLight(map: RadianceMap): void {
    this.lights.setMap(map);
    this.reflections.setMap(map);
    this.hasLight = true;
    this.restart();
  }

  /** A model of height 1 that stands on y = 0; `surface` replaces its own where it is given. */
  setModel(model: Object3D, surface: Surface | null): void {
    for (const old of this.holder.children) disposeMaterials(old);
    this.holder.clear();
    const shared = { ...this.lights.uniforms, ...this.reflections.uniforms, bias: this.bias };
    model.traverse((part) => {
      if (!(part instanceof Mesh)) return;
      const own = (part.userData.surfaces as Surface[] | undefined) ?? [FINISHES.clay!];
      const made = (surface ? [surface] : own).map((one) => objectMaterial(one, shared));
      part.material = made.length === 1 ? made[0] : made;
    });
    this.holder.add(model);
    this.restart();
  }

  place(placement: Placement): void {
    this.placement = placement;
    this.restart();
  }

  /** The point of the ground under a place of the photo (pixels); null at and above the horizon. */
  groundAt(column: number, row: number): { x: number; z: number } | null {
    const { focal_px, principal } = this.pinhole;
    const down = row - principal[1];
    if (down <= 0) return null;
    const z = (this.placement.cameraHeight * focal_px) / down;
    return { x: ((column - principal[0]) * z) / focal_px, z };
  }

  private restart(): void {
    this.batch = 0;
    this.progress(0, BATCHES);
    this.ask();
  }

  private ask(): void {
    this.asked ||= requestAnimationFrame(() => {
      this.asked = 0;
      this.frame();
      if (this.batch < BATCHES && this.isReady) this.ask();
    });
  }

  private get isReady(): boolean {
    return this.hasLight && this.holder.children.length > 0;
  }

  private frame(): void {
    if (this.isReady) this.addBatch();
    this.progress(this.batch, BATCHES);
    // often at first; later a batch hardly changes the mean
    if (this.batch > 8 && this.batch % 8) return;
    const { show } = this;
    show.uniforms.objectSum!.value = this.sums[0].textures[0];
    show.uniforms.groundSum!.value = this.sums[0].textures[1];
    show.uniforms.batches!.value = this.isReady ? this.batch : 0;
    this.drawScreen(show, null);
  }

  private addBatch(): void {
    const { renderer, holder, placement } = this;
    if (this.batch === 0) this.clearSums();
    holder.position.set(placement.x, 0, -placement.z);
    holder.scale.setScalar(placement.size);
    holder.rotation.y = (placement.turnDeg * Math.PI) / 180;
    holder.updateMatrixWorld(true);
    this.bias.value = 0.012 * placement.size;
    this.sink.value = 0.004 * placement.size;

    this.lights.prepare(this.batch, this.objectScene, holder);
    this.aim();
    renderer.setClearColor(0x000000, 0);
    renderer.setRenderTarget(this.objectTarget);
    renderer.render(this.objectScene, this.camera);

    renderer.setRenderTarget(this.groundTarget);
    renderer.render(this.groundScene, this.camera);
    (this.show.uniforms.unshadowed!.value as Vector3).add(this.lights.onGround);

    this.add.uniforms.objectSum!.value = this.sums[0].textures[0];
    this.add.uniforms.groundSum!.value = this.sums[0].textures[1];
    const [, next] = this.sums;
    const touched = [...cornersOf(holder), ...this.lights.cornersOnGround()];
    next.scissorTest = boundOnScreen(touched, this.camera, this.canvas, next.scissor);
    this.drawScreen(this.add, next);
    next.scissorTest = false;
    this.sums.reverse();
    this.batch++;
  }

  private clearSums(): void {
    (this.show.uniforms.unshadowed!.value as Vector3).set(0, 0, 0);
    this.renderer.setClearColor(0x000000, 0);
    for (const sum of this.sums) {
      this.renderer.setRenderTarget(sum);
      this.renderer.clear();
    }
  }

  /** The photo's camera, shifted within a pixel: the batches together smooth the edges. */
  private aim(): void {
    const { focal_px, width, height, principal } = this.pinhole;
    const { camera, placement } = this;
    const pixel = width / this.canvas.width;
    const dx = (halton(this.batch + 1, 2) - 0.5) * pixel;
    const dy = (halton(this.batch + 1, 3) - 0.5) * pixel;
    const toNear = NEAR / focal_px;
    camera.position.set(0, placement.cameraHeight, 0);
    camera.updateMatrixWorld();
    camera.projectionMatrix.makePerspective(
      (-principal[0] + dx) * toNear,
      (width - principal[0] + dx) * toNear,
      (principal[1] + dy) * toNear,
      (principal[1] - height + dy) * toNear,
      NEAR,
      1000,
    );
    camera.projectionMatrixInverse.copy(camera.projectionMatrix).invert();
  }

  private drawScreen(material: ShaderMaterial, target: WebGLRenderTarget | null): void {
    this.screen.material = material;
    this.renderer.setRenderTarget(target);
    this.renderer.render(this.screenScene, this.screenCamera);
  }

  dispose(): void {
    cancelAnimationFrame(this.asked);
    this.lights.dispose();
    this.reflections.dispose();
    for (const target of [this.objectTarget, this.groundTarget, ...this.sums]) target.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

/** Van der Corput's sequence in a base: in [0, 1), evenly spread however long. */
function halton(index: number, base: number): number {
  let value = 0;
  for (let share = 1 / base, rest = index; rest > 0; share /= base, rest = Math.floor(rest / base))
    value += (rest % base) * share;
  return value;
}

function disposeMaterials(model: Object3D): void {
  model.traverse((part) => {
    if (!(part instanceof Mesh)) return;
    for (const one of [part.material].flat() as ShaderMaterial[]) one.dispose();
  });
}
