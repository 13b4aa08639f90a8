import { Box3, DirectionalLight, HemisphereLight, Mesh, type Object3D, PerspectiveCamera, Scene, Vector3, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { el } from "../shared/dom";

const STEP = Math.PI / 18;

/**
 * A picture of an object that can be turned: by dragging, or by the arrow keys, with + and - to
 * come nearer and go back. It is drawn when something changes, not all the time.
 */
export class Turntable {
  readonly element: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(30, 1, 0.01, 100);
  private readonly controls: OrbitControls;
  private readonly resized = new ResizeObserver(() => this.resize());
  private asked = 0;
  private shown: Object3D | undefined;

  constructor(label: string) {
    const help = "Drag to turn it, or use the arrow keys; + and − come nearer and go back.";
    this.canvas = el("canvas", {
      class: "turntable",
      tabindex: 0,
      role: "img",
      "aria-label": `${label}. ${help}`,
    });
    this.element = el("figure", {}, this.canvas, el("figcaption", {}, help));
    this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: true, alpha: true });
    const sun = new DirectionalLight(0xffffff, 1.6);
    sun.position.set(1, 2, 1.5);
    this.camera.add(sun);
    this.scene.add(this.camera, new HemisphereLight(0xffffff, 0x8899aa, 1.6));
    this.camera.position.set(0.55, 0.5, 1).setLength(4.1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.enablePan = false;
    this.controls.enableZoom = false; // the page scrolls over it
    this.controls.addEventListener("change", () => this.draw());
    this.canvas.addEventListener("keydown", (event) => this.key(event));
    this.resized.observe(this.canvas);
  }

  /** Shows this object alone, as large as the picture. */
  show(object: Object3D): void {
    if (this.shown) this.scene.remove(this.shown);
    object.scale.setScalar(1);
    object.position.setScalar(0);
    object.updateMatrixWorld(true);
    const box = new Box3();
    object.traverseVisible((part) => part instanceof Mesh && box.expandByObject(part));
    const centre = box.getCenter(new Vector3());
    const radius = reach(object, centre);
    object.scale.setScalar(1 / radius);
    object.position.copy(centre).divideScalar(-radius);
    this.scene.add(object);
    this.shown = object;
    this.draw();
  }

  draw(): void {
    this.asked ||= requestAnimationFrame(() => {
      this.asked = 0;
      this.renderer.render(this.scene, this.camera);
    });
  }

  dispose(): void {
    cancelAnimationFrame(this.asked);
    this.resized.disconnect();
    this.controls.dispose();
    this.renderer.dispose();
  }

  private key(event: KeyboardEvent): void {
    const turns: Record<string, [number, number, number]> = {
      ArrowLeft: [-1, 0, 1],
      ArrowRight: [1, 0, 1],
      ArrowUp: [0, -1, 1],
      ArrowDown: [0, 1, 1],
      "+": [0, 0, 0.9],
      "=": [0, 0, 0.9], // the same key without shift
      "-": [0, 0, 1 / 0.9],
    };
    const turn = turns[event.key];
    if (!turn) return;
    event.preventDefault();
    const { position } = this.camera;
    const distance = Math.min(8, Math.max(2.2, position.length() * turn[2]));
    const azimuth = Math.atan2(position.x, position.z) + STEP * turn[0];
    const height = Math.acos(position.y / position.length()) + STEP * turn[1];
    position.setFromSphericalCoords(distance, Math.min(Math.PI - 0.05, Math.max(0.05, height)), azimuth);
    this.controls.update();
    this.draw();
  }

  private resize(): void {
    const { clientWidth, clientHeight } = this.canvas;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / Math.max(1, clientHeight);
    this.camera.updateProjectionMatrix();
    this.draw();
  }
}

/** The distance of the farthest visible vertex from a point. */
function reach(object: Object3D, centre: Vector3): number {
  const vertex = new Vector3();
  let farthest = 0;
  object.traverseVisible((part) => {
    if (!(part instanceof Mesh)) return;
    const positions = part.geometry.getAttribute("position");
    for (let i = 0; i < positions.count; i++) {
      vertex.fromBufferAttribute(positions, i).applyMatrix4(part.matrixWorld);
      farthest = Math.max(farthest, vertex.distanceTo(centre));
    }
  });
  return farthest;
}
