import {
  BackSide, BoxGeometry, BufferAttribute, type BufferGeometry, Color, DataTexture, DirectionalLight, FloatType, FrontSide, LinearFilter,
  LinearToneMapping, Mesh, MeshLambertMaterial, PCFShadowMap, PerspectiveCamera, RepeatWrapping, RGBAFormat,
  Scene, ShaderMaterial, WebGLRenderer,
} from "three";
import type { Sky } from "./decoder.worker";
import { COLUMNS, direction, ROWS } from "./latlong";
import type { StillLife } from "./still_life";

/** What the ball throws back: a polished one of steel, so that it stands out from the ground. */
const STEEL = 0.75;
const SHADOW_TEXELS = 512;
/** Of the knot and the ball, from their middle. */
const REACH = 1.65;

/**
 * The still life under a decoded sky, in the sky's own units.
 *
 * Sun: a directional light of the latent's energy and direction, its shadow by a shadow map whose
 * softness follows the lobe's width at one distance. Sky and ground: precomputed transport, at
 * vertices. The mirror ball shows the map, with the sun in it. What is left out: light that the
 * knot and the ball pass on, their shadow in the light that the ground throws back, and their
 * image in the ball.
 */
export class SkyScene {
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(34, 1, 0.1, 100);
  private readonly sunLight = new DirectionalLight();
  private readonly map: DataTexture;
  private readonly farGround = new Color();
  private readonly groundMaterial = lit(new MeshLambertMaterial(), this.farGround);
  private readonly lightAt: BufferAttribute[];

  constructor(canvas: HTMLCanvasElement, life: StillLife) {
    this.renderer = new WebGLRenderer({ canvas, antialias: false });
    this.renderer.toneMapping = LinearToneMapping;
    this.renderer.shadowMap.enabled = true;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.map = new DataTexture(new Float32Array(2 * ROWS * COLUMNS * 4), COLUMNS, 2 * ROWS, RGBAFormat, FloatType);
    this.map.internalFormat = "RGBA16F"; // every WebGL 2 filters half floats
    this.map.minFilter = this.map.magFilter = LinearFilter;
    this.map.wrapS = RepeatWrapping;
    this.lightAt = [life.knot, life.ground].map(withLight);

    const knot = new Mesh(life.knot, lit(new MeshLambertMaterial({ color: new Color(0.6, 0.6, 0.6) })));
    const ball = new Mesh(life.ball, this.showing("reflect(normalize(vPosition - cameraPosition), normalize(vNormal))", STEEL));
    const ground = new Mesh(life.ground, this.groundMaterial);
    // by their near sides: the far ones touch the ground and would let light in under them
    knot.material.shadowSide = ball.material.shadowSide = FrontSide;
    knot.castShadow = knot.receiveShadow = ball.castShadow = ground.receiveShadow = true;
    const backdrop = new Mesh(new BoxGeometry(100, 100, 100), this.showing("normalize(vPosition - cameraPosition)"));
    backdrop.material.side = BackSide;
    backdrop.renderOrder = 1; // after the rest, where nothing stands before it
    this.scene.add(backdrop, ground, knot, ball, this.sunLight, this.sunLight.target);

    this.sunLight.target.position.set(0.1, 0.7, 0);
    this.sunLight.shadow.mapSize.set(SHADOW_TEXELS, SHADOW_TEXELS);
    this.sunLight.shadow.normalBias = 0.02;
    const { camera } = this.sunLight.shadow;
    [camera.left, camera.right, camera.bottom, camera.top] = [-REACH, REACH, -REACH, REACH];
    [camera.near, camera.far] = [0.5, 60];
    this.sunLight.castShadow = true;
  }

  /** Takes a new sky; `draw` shows it. */
  setSky({ map, irradiance, sun, wish }: Sky): void {
    const texels = this.map.image.data as Float32Array;
    for (let pixel = 0; pixel < map.length / 3; pixel++) {
      // half floats end at 65504; only the mirror ball and the background see the cut
      for (let c = 0; c < 3; c++) texels[4 * pixel + c] = Math.min(map[3 * pixel + c]!, 65000);
    }
    this.map.needsUpdate = true;
    let start = 0;
    for (const attribute of this.lightAt) {
      (attribute.array as Float32Array).set(irradiance.subarray(start, start + attribute.array.length));
      attribute.needsUpdate = true;
      start += attribute.array.length;
    }
    this.groundMaterial.color.setRGB(...wish.albedo);
    this.farGround.fromArray(map, map.length - 3);
    const towards = direction(wish.azimuth, sun.zenith);
    this.sunLight.color.setRGB(...sun.energy);
    this.sunLight.position.set(...towards).multiplyScalar(20).add(this.sunLight.target.position);
    const width = 0.6 / Math.sqrt(sun.kappa); // of the lobe, at 0.6 from what casts the shadow
    this.sunLight.shadow.radius = Math.min(5, Math.max(1, (width * SHADOW_TEXELS) / (2 * REACH)));
  }

  /** `viewAzimuth`: where the camera looks (radians); `exposure` multiplies radiance. */
  draw(viewAzimuth: number, exposure: number): void {
    const [x, , z] = direction(viewAzimuth, Math.PI / 2);
    this.camera.position.set(-4.6 * x, 1.75, -4.6 * z);
    this.camera.lookAt(0.15, 0.82, 0);
    this.renderer.toneMappingExposure = exposure;
    this.renderer.render(this.scene, this.camera);
  }

  /** `sharpness`: of each side, 1 for all the pixels that the screen has. */
  resize(width: number, height: number, sharpness: number): void {
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2) * sharpness);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  dispose(): void {
    this.scene.traverse((one) => {
      if (one instanceof Mesh) {
        one.geometry.dispose();
        one.material.dispose();
      }
    });
    this.map.dispose();
    this.renderer.dispose();
  }

  /** A surface that shows the map's radiance in a direction, which is given as an expression. */
  private showing(towards: string, reflectance = 1): ShaderMaterial {
    return new ShaderMaterial({
      uniforms: { map: { value: this.map } },
      defines: { HALF_ROW: 0.25 / ROWS, REFLECTANCE: reflectance.toFixed(3) },
      vertexShader: `
        varying vec3 vPosition, vNormal;
        void main() {
          vPosition = (modelMatrix * vec4(position, 1.0)).xyz;
          vNormal = mat3(modelMatrix) * normal;
          gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
        }`,
      fragmentShader: `
        uniform sampler2D map;
        varying vec3 vPosition, vNormal;
        const float PI_ = 3.14159265358979;
        void main() {
          vec3 towards = ${towards};
          float column = atan(towards.x, -towards.z) / (2.0 * PI_) + 0.5;
          float row = acos(clamp(towards.y, -1.0, 1.0)) / PI_;
          // no mixing across the horizon
          row = towards.y > 0.0 ? min(row, 0.5 - HALF_ROW) : max(row, 0.5 + HALF_ROW);
          gl_FragColor = vec4(REFLECTANCE * texture2D(map, vec2(column, row)).rgb, 1.0);
          #include <tonemapping_fragment>
          #include <colorspace_fragment>
        }`,
    });
  }
}

function withLight(geometry: BufferGeometry): BufferAttribute {
  const light = new BufferAttribute(new Float32Array(geometry.getAttribute("position").count * 3), 3);
  geometry.setAttribute("skyIrradiance", light);
  return light;
}

/**
 * The vertices' irradiance, added to what the lights give. With `far`, a surface fades into that
 * radiance as the vertices' "farness" goes from 0 to 1.
 */
function lit(material: MeshLambertMaterial, far?: Color): MeshLambertMaterial {
  material.onBeforeCompile = (shader) => {
    if (far) shader.uniforms.far = { value: far };
    const declared = `varying vec3 vSkyIrradiance;${far ? "uniform vec3 far; varying float vFarness;" : ""}\n`;
    const attributes = `attribute vec3 skyIrradiance;${far ? "attribute float farness;" : ""}\n`;
    shader.vertexShader = shader.vertexShader
      .replace("#include <common>", `${attributes}${declared}#include <common>`)
      .replace(
        "#include <begin_vertex>",
        `#include <begin_vertex>\nvSkyIrradiance = skyIrradiance;${far ? "vFarness = farness;" : ""}`,
      );
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", `${declared}#include <common>`)
      .replace("#include <lights_fragment_end>", "irradiance += vSkyIrradiance;\n#include <lights_fragment_end>");
    if (!far) return;
    shader.fragmentShader = shader.fragmentShader.replace(
      "#include <opaque_fragment>",
      "outgoingLight = mix(outgoingLight, far, vFarness);\n#include <opaque_fragment>",
    );
  };
  // three tells programs apart by the text of the function above
  material.customProgramCacheKey = () => (far ? "lit, fading" : "lit");
  return material;
}
