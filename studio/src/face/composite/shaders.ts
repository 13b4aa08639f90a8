/** GLSL of the composite; LIGHTS lights a batch, their shadow maps the tiles of one atlas. */
export const LIGHTS = 16;
export const TILES = 4; // a side
/** The sine of the height below which a light is taken to leave the ground dark. */
export const GRAZING = "0.02";

const LIGHTING = /* glsl */ `
  uniform vec3 towards[${LIGHTS}];
  uniform vec3 flux[${LIGHTS}];
  uniform mat4 shadowMatrix[${LIGHTS}]; // world to the unit cube of the light's tile
  uniform highp sampler2D atlas;

  // 1 where no part of the object stands between the point and light i
  float visible(int i, vec3 point) {
    vec3 at = (shadowMatrix[i] * vec4(point, 1.0)).xyz;
    if (any(lessThan(at.xy, vec2(0.0))) || any(greaterThan(at.xy, vec2(1.0)))) return 1.0;
    vec2 tile = vec2(float(i % ${TILES}), float(i / ${TILES}));
    return at.z <= texture(atlas, (tile + at.xy) / ${TILES}.0).r ? 1.0 : 0.0;
  }
`;

export const OBJECT_VERTEX = /* glsl */ `
  out vec3 point;
  out vec3 normalAt;
  out vec2 uvAt;
  out vec3 colorAt;
  void main() {
    vec4 world = modelMatrix * vec4(position, 1.0);
    point = world.xyz;
    normalAt = mat3(modelMatrix) * normal; // only uniform scales
    uvAt = uv;
    colorAt = vec3(1.0);
    #ifdef USE_COLOR
      colorAt = color.rgb;
    #elif defined(USE_COLOR_ALPHA)
      colorAt = color.rgb;
    #endif
    gl_Position = projectionMatrix * viewMatrix * world;
  }
`;

// Lambert's share of the lights, each with its shadow, and the mirrored environment: sharp at
// roughness 0, silver at 0.5, a cosine lobe at 1, in between mixed.
export const OBJECT_FRAGMENT = /* glsl */ `
  ${LIGHTING}
  uniform vec3 baseColor;
  uniform sampler2D baseMap;
  uniform float roughness;
  uniform float metalness;
  uniform float gloss; // reflectance of the surface head-on where it is no metal
  uniform float bias; // metres along the normal, against a surface shadowing itself
  uniform sampler2D mirrorMap;
  uniform sampler2D silverMap;
  uniform sampler2D matteMap;
  in vec3 point;
  in vec3 normalAt;
  in vec2 uvAt;
  in vec3 colorAt;
  layout(location = 0) out vec4 radiance;

  const float PI = 3.141592653589793;

  vec3 environment(vec3 direction) {
    vec2 at = vec2(atan(direction.x, -direction.z) / (2.0 * PI) + 0.5, 1.0 - acos(clamp(direction.y, -1.0, 1.0)) / PI);
    vec3 silver = textureLod(silverMap, at, 0.0).rgb;
    return roughness < 0.5
      ? mix(textureLod(mirrorMap, at, 0.0).rgb, silver, roughness * 2.0)
      : mix(silver, textureLod(matteMap, at, 0.0).rgb, roughness * 2.0 - 1.0);
  }

  void main() {
    vec3 outward = normalize(cameraPosition - point);
    vec3 n = normalize(normalAt);
    if (dot(n, outward) < 0.0) n = -n;
    vec3 color = baseColor * colorAt * texture(baseMap, uvAt).rgb;
    vec3 start = point + bias * n;
    vec3 irradiance = vec3(0.0);
    for (int i = 0; i < ${LIGHTS}; i++) {
      float cosine = dot(n, towards[i]);
      if (cosine > 0.0) irradiance += flux[i] * cosine * visible(i, start);
    }
    vec3 headOn = mix(vec3(gloss), color, metalness);
    vec3 edge = max(vec3(1.0 - roughness), headOn); // Schlick, with less of it on rough surfaces
    vec3 fresnel = headOn + (edge - headOn) * pow(1.0 - abs(dot(n, outward)), 5.0) * step(1e-4, gloss + metalness);
    vec3 diffuse = color * (1.0 - metalness) / PI * irradiance;
    vec3 mirrored = gloss + metalness > 0.0 ? fresnel * environment(reflect(-outward, n)) : vec3(0.0);
    radiance = vec4(diffuse * (1.0 - (1.0 - metalness) * fresnel) + mirrored, 1.0);
  }
`;

// One quad a light: its tile, cast on the ground. Beyond it the light reaches the ground.
export const GROUND_VERTEX = /* glsl */ `
  uniform vec3 towards[${LIGHTS}];
  uniform vec3 corners[${4 * LIGHTS}];
  flat out int light;
  out vec3 point;
  void main() {
    light = gl_InstanceID;
    point = corners[4 * gl_InstanceID + gl_VertexID];
    gl_Position = towards[light].y > ${GRAZING} ? projectionMatrix * viewMatrix * vec4(point, 1.0) : vec4(2.0);
  }
`;

export const GROUND_FRAGMENT = /* glsl */ `
  ${LIGHTING}
  uniform float sink; // metres below the ground, so that the object's own foot shades it
  flat in int light;
  in vec3 point;
  layout(location = 0) out vec4 blocked;
  void main() {
    float shade = 1.0 - visible(light, point - vec3(0.0, sink, 0.0));
    blocked = vec4(flux[light] * towards[light].y * shade, 0.0);
  }
`;

export const SCREEN_VERTEX = /* glsl */ `
  out vec2 at;
  void main() {
    at = uv;
    gl_Position = vec4(position.xy, 0.0, 1.0);
  }
`;

export const ADD_FRAGMENT = /* glsl */ `
  uniform sampler2D objectSum;
  uniform sampler2D groundSum;
  uniform sampler2D object;
  uniform sampler2D ground;
  in vec2 at;
  layout(location = 0) out vec4 newObjectSum;
  layout(location = 1) out vec4 newGroundSum;
  void main() {
    newObjectSum = texture(objectSum, at) + texture(object, at);
    newGroundSum = texture(groundSum, at) + texture(ground, at);
  }
`;

// object + (1 - coverage) photo x (irradiance with the object / without), then sRGB
export const PHOTO_FRAGMENT = /* glsl */ `
  uniform sampler2D objectSum;
  uniform sampler2D groundSum;
  uniform sampler2D photo;
  uniform vec3 unshadowed;
  uniform float batches;
  in vec2 at;
  layout(location = 0) out vec4 shown;

  vec3 decode(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
  }
  vec3 encode(vec3 c) {
    c = clamp(c, 0.0, 1.0);
    return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  }

  void main() {
    vec3 background = decode(texture(photo, at).rgb);
    if (batches > 0.0) {
      vec4 front = texture(objectSum, at) / batches;
      vec3 blocked = texture(groundSum, at).rgb / max(unshadowed, vec3(1e-20));
      background = front.rgb + (1.0 - front.a) * background * clamp(1.0 - blocked, 0.0, 1.0);
    }
    shown = vec4(encode(background), 1.0);
  }
`;
