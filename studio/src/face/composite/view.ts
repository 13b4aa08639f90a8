import {
  Box3,
  FloatType,
  Group,
  HalfFloatType,
  Mesh,
  NearestFilter,
  NoColorSpace,
  OrthographicCamera,
  PerspectiveCamera,
  PlaneGeometry,
  Scene,
  Sphere,
  Texture,
  Vector3,
  Vector4,
  WebGLRenderer,
  WebGLRenderTarget,
  type Color,
  type Object3D,
  type ShaderMaterial,
  type TextureDataType,
} from "three";
import type { Edit } from "../../shared/edit";
import type { RadianceMap } from "../../shared/radiance_map";
import { boundOnScreen, cornersOf, cornersOfBox, NEAR } from "./render/bounds";
import { BATCHES, LightBatch } from "./render/lights";
import { albedoOf, FINISHES, objectMaterial, Reflections, type Surface } from "./materials";
import { rod, trayFor, type Model } from "./models";
import { depthOnly, fullScreen, setSums, summedQuads, sumUniforms, type Uniforms } from "./render/passes";
import { People, type Person } from "./people";
import type { Placement, Stand } from "./placement";
import type { Pinhole } from "./plane";
import {
  ADD_FRAGMENT,
  BOUNCE_FRAGMENT,
  BOUNCE_REACH,
  BOUNCE_VERTEX,
  GROUND_VERTEX,
  LIGHTS,
  OBJECT_ON_GROUND_FRAGMENT,
  OWN,
  PERSON_ON_GROUND_FRAGMENT,
  PHOTO_FRAGMENT,
} from "./render/shaders";
import { ShadowMaps } from "./render/shadow_maps";
import { Surroundings } from "./render/surroundings";

/** A photo with what is known of it. */
export interface SeenPhoto {
  /** At any size; the camera's aspect. */
  image: TexImageSource;
  camera: Pinhole;
  /** Those whose heads are known: the first is whom objects are placed beside. */
  people: readonly Person[];
  /** Of all faces, pixels of the photo, so that no object is put before them. */
  faces: readonly (readonly [x: number, y: number, width: number, height: number])[];
}

/**
 * A photo with an object in it, lit by a map, in the camera's frame. Light comes in batches of 16
 * shadowed lights, one batch a frame, averaged in float targets until all 1024 are in; whatever
 * moves starts it anew.
 */
export class CompositeView {
  private readonly renderer: WebGLRenderer;
  private readonly lights = new LightBatch();
  private readonly objectShadows: ShadowMaps;
  private readonly personShadows: ShadowMaps;
  private readonly reflections = new Reflections();
  private readonly people: People;
  private readonly objectScene = new Scene();
  private readonly rodScene = new Scene();
  private readonly personScene = new Scene();
  private readonly groundScene = new Scene();
  private readonly holder = new Group();
  private readonly rod = rod();
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
  private readonly unshadowed = new Vector3();
  private readonly surroundings = new Surroundings();
  private readonly shared: Uniforms;
  private model: Model | null = null;
  private albedos: Color[] = [];
  private tray: Mesh | null = null;
  private placement: Placement = { foot: [0, 0, -1], size: 0.1, turnDeg: 0 };
  private stand: Stand = { kind: "held", depth: 1 };
  private readonly edit = { value: new Vector3(1, 1, 1) };
  private hasLight = false;
  private batch = 0;
  private asked = 0;

  /** Throws where the browser has no WebGL 2 with float targets. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly photo: SeenPhoto,
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
    this.renderer.setClearColor(0x000000, 0);
    this.people = new People(photo.people);
    this.objectShadows = new ShadowMaps(this.renderer, this.lights);
    this.personShadows = new ShadowMaps(this.renderer, this.lights);
    const picture = new Texture(photo.image);
    picture.colorSpace = NoColorSpace; // decoded in the shader, so that untouched pixels stay as they are
    picture.generateMipmaps = false;
    picture.needsUpdate = true;
    const { focal_px, principal } = photo.camera;
    const [wide, high] = [photo.camera.width, photo.camera.height];
    this.shared = {
      ...this.lights.uniforms,
      ...this.reflections.uniforms,
      ...this.surroundings.uniforms,
      objectBounds: this.objectShadows.bounds,
      objectAtlas: this.objectShadows.atlas,
      personBounds: this.personShadows.bounds,
      personAtlas: this.personShadows.atlas,
      bias: this.bias,
      photo: { value: picture },
      edit: this.edit,
      pinhole: { value: new Vector4(focal_px / wide, focal_px / high, principal[0] / wide, 1 - principal[1] / high) },
    };

    const target = (count: number, type: TextureDataType, depthBuffer: boolean): WebGLRenderTarget => {
      const filter = { minFilter: NearestFilter, magFilter: NearestFilter };
      return new WebGLRenderTarget(width, height, { type, ...filter, depthBuffer, count });
    };
    this.objectTarget = target(1, FloatType, true);
    this.groundTarget = target(2, HalfFloatType, true); // blended into, which full floats may not offer
    this.sums = [target(3, FloatType, false), target(3, FloatType, false)];
    this.add = fullScreen(ADD_FRAGMENT, {
      ...sumUniforms(),
      object: { value: this.objectTarget.texture },
      blocked: { value: this.groundTarget.textures[0] },
      before: { value: this.groundTarget.textures[1] },
    });
    this.show = fullScreen(PHOTO_FRAGMENT, {
      ...sumUniforms(),
      photo: { value: picture },
      edit: this.edit,
      unshadowed: { value: this.unshadowed },
      batches: { value: 0 },
    });
    this.groundScene.add(
      summedQuads(LIGHTS, GROUND_VERTEX, OBJECT_ON_GROUND_FRAGMENT, {
        ...this.shared,
        corners: this.objectShadows.corners,
        sink: this.sink,
      }),
      summedQuads(LIGHTS, GROUND_VERTEX, PERSON_ON_GROUND_FRAGMENT, {
        ...this.shared,
        corners: this.personShadows.corners,
      }),
      summedQuads(OWN, BOUNCE_VERTEX, BOUNCE_FRAGMENT, this.shared),
    );
    this.objectScene.add(this.holder);
    this.rod.material = objectMaterial(FINISHES.stand!, this.shared, false);
    this.rodScene.add(this.rod);
    this.personScene.overrideMaterial = depthOnly();
    this.screenScene.add(this.screen);
    this.restart();
  }

  /** Radiance in the photo's units and colours, before what was done to it. */
  setLight(map: RadianceMap, { saturation, contrast, pivot }: Edit): void {
    this.edit.value.set(saturation, contrast, pivot);
    this.lights.setMap(map);
    this.reflections.setMap(map);
    this.hasLight = true;
    this.restart();
  }

  /** `surface` replaces the model's own where it is given. */
  setModel(model: Model, surface: Surface | null): void {
    this.holder.traverse(disposeMaterials);
    this.tray?.traverse(disposeMaterials);
    this.holder.clear();
    this.model = model;
    this.albedos = [];
    model.object.traverse((part) => {
      if (!(part instanceof Mesh)) return;
      const own = (part.userData.surfaces as Surface[] | undefined) ?? [FINISHES.clay!];
      const made = (surface ? [surface] : own).map((one) => objectMaterial(one, this.shared));
      part.material = made.length === 1 ? made[0] : made;
      this.albedos.push(albedoOf(surface ?? own[0]!));
    });
    this.tray = trayFor(model);
    this.tray.material = objectMaterial(FINISHES.stand!, this.shared);
    this.holder.add(model.object);
    this.restart();
  }

  place(placement: Placement, stand: Stand): void {
    this.placement = placement;
    this.stand = stand;
    this.restart();
  }

  /** Whether a place of the photo (pixels) is on the object, or within so many pixels of its box. */
  isOnObject([column, row]: readonly [number, number], within: number): boolean {
    if (!this.model) return false;
    this.arrange();
    this.aim();
    const { width, height } = this.photo.camera;
    const box = new Vector4();
    if (!boundOnScreen(cornersOf(this.model.object), this.camera, { width, height }, box)) return false;
    const up = height - row;
    return column > box.x - within && column < box.x + box.z + within && up > box.y - within && up < box.y + box.w + within;
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
    return this.hasLight && this.model !== null;
  }

  private frame(): void {
    if (this.isReady) this.addBatch();
    this.progress(this.batch, BATCHES);
    // often at first; later a batch hardly changes the mean
    if (this.batch > 8 && this.batch % 8) return;
    setSums(this.show, this.sums[0]);
    this.show.uniforms.batches!.value = this.isReady ? this.batch : 0;
    this.drawScreen(this.show, null);
  }

  /** Puts everything where the placement says. */
  private arrange(): void {
    const { holder, placement, stand, tray, rodScene } = this;
    const model = this.model!;
    const { foot, size, turnDeg } = placement;
    const up = new Vector3(...(stand.kind === "plane" ? stand.plane.normal : ([0, 1, 0] as const)));
    holder.position.set(...foot);
    holder.scale.setScalar(size);
    holder.quaternion.setFromUnitVectors(UP, up);
    holder.rotateY((turnDeg * Math.PI) / 180);
    const isHeld = stand.kind === "held";
    if (isHeld && !model.areBalls) holder.add(tray!);
    else holder.remove(tray!);
    holder.updateMatrixWorld(true);
    this.bias.value = 0.012 * size;
    this.sink.value = 0.004 * size;
    // balls are threaded on it
    const through = model.areBalls ? model.spheres.at(-1)![1] * size : 0;
    this.rod.position.set(foot[0], foot[1] + through, foot[2]);
    if (isHeld) rodScene.add(this.rod);
    else rodScene.remove(this.rod);
    rodScene.updateMatrixWorld(true);
    this.surroundings.set(model, this.albedos, holder.matrixWorld, stand, this.people);
  }

  private addBatch(): void {
    const { renderer, holder, people, personScene, stand } = this;
    if (this.batch === 0) this.clearSums();
    this.arrange();
    this.lights.take(this.batch);
    const object = sphereAbout(holder);
    this.objectShadows.draw(this.objectScene, object);
    // what is not where it seems, before somebody or in his lap, does not stand in his light
    const box = new Box3().setFromObject(holder);
    const isStanding = stand.kind === "plane";
    const isClear = (body: Object3D): boolean => !new Box3().setFromObject(body).intersectsBox(box);
    const shoulders = isClear(people.shoulders) && people.shoulders;
    const trunks = isStanding && isClear(people.trunks) && people.trunks;
    setChildren(personScene, people.heads, shoulders, trunks);
    this.personShadows.draw(personScene, people.spheres.length ? sphereAbout(personScene) : null);

    this.aim();
    if (!isStanding) setChildren(personScene, people.heads);
    renderer.setRenderTarget(this.objectTarget);
    renderer.clear();
    renderer.autoClear = false;
    for (const scene of [personScene, this.objectScene, this.rodScene]) renderer.render(scene, this.camera);

    renderer.setRenderTarget(this.groundTarget);
    renderer.clear();
    const touched = cornersOf(holder);
    if (isStanding) {
      touched.push(...this.objectShadows.castOn(stand.plane), ...this.cornersOfBounce());
      this.personShadows.castOn(stand.plane);
      renderer.render(personScene, this.camera);
      renderer.render(this.groundScene, this.camera);
      this.lights.addIrradiance(new Vector3(...stand.plane.normal), this.unshadowed);
    } else touched.push(...cornersOf(this.rod));
    renderer.autoClear = true;

    setSums(this.add, this.sums[0]);
    const [, next] = this.sums;
    next.scissorTest = boundOnScreen(touched, this.camera, this.canvas, next.scissor);
    this.drawScreen(this.add, next);
    next.scissorTest = false;
    this.sums.reverse();
    this.batch++;
  }

  /** Of cubes about all of the plane that the object's light falls on. */
  private cornersOfBounce(): Vector3[] {
    return this.surroundings.uniforms.own.value.flatMap(({ x, y, z, w }) =>
      cornersOfBox(new Box3().setFromCenterAndSize(new Vector3(x, y, z), new Vector3().setScalar(2 * BOUNCE_REACH * w))),
    );
  }

  private clearSums(): void {
    this.unshadowed.set(0, 0, 0);
    for (const sum of this.sums) {
      this.renderer.setRenderTarget(sum);
      this.renderer.clear();
    }
  }

  /** The photo's camera, shifted within a pixel: the batches together smooth the edges. */
  private aim(): void {
    const { focal_px, width, height, principal } = this.photo.camera;
    const { camera } = this;
    const pixel = width / this.canvas.width;
    const dx = (halton(this.batch + 1, 2) - 0.5) * pixel;
    const dy = (halton(this.batch + 1, 3) - 0.5) * pixel;
    const toNear = NEAR / focal_px;
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
    this.objectShadows.dispose();
    this.personShadows.dispose();
    this.reflections.dispose();
    for (const target of [this.objectTarget, this.groundTarget, ...this.sums]) target.dispose();
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

const UP = new Vector3(0, 1, 0);

const sphereAbout = (object: Object3D): Sphere => new Box3().setFromObject(object).getBoundingSphere(new Sphere());

function setChildren(scene: Scene, ...children: (Object3D | false)[]): void {
  scene.clear();
  for (const child of children) if (child) scene.add(child);
}

/** Van der Corput's sequence in a base: in [0, 1), evenly spread however long. */
function halton(index: number, base: number): number {
  let value = 0;
  for (let share = 1 / base, rest = index; rest > 0; share /= base, rest = Math.floor(rest / base))
    value += (rest % base) * share;
  return value;
}

function disposeMaterials(part: Object3D): void {
  if (!(part instanceof Mesh)) return;
  for (const one of [part.material].flat() as ShaderMaterial[]) one.dispose();
}
