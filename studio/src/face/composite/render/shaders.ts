import { EDIT } from "../../../shared/edit";

/** GLSL of the composite; LIGHTS lights a batch, their shadow maps the tiles of one atlas. */
export const LIGHTS = 16;
export const TILES = 4; // a side
/** The sine of the height below which a light is taken to leave the plane dark. */
export const GRAZING = "0.02";
/** At most so many spheres stand for the object, and so many for what it is seen beside. */
export const OWN = 2;
export const OTHERS = 10;
/** The quad that a sphere's light falls on reaches so many of its radii: beyond, less than 0.5 %. */
const BOUNCE_RADII = "6.0";
/** No corner of it is farther from the sphere's middle than so many radii. */
export const BOUNCE_REACH = 10;

const LIGHTING = /* glsl */ `
  uniform vec3 towards[${LIGHTS}];
  uniform vec3 sideways[${LIGHTS}]; // across the light's tile
  uniform vec3 flux[${LIGHTS}];
  uniform vec4 objectBounds; // centre and radius of the sphere that the tiles hold
  uniform vec4 personBounds; // radius 0 where there is nobody
  uniform highp sampler2D objectAtlas;
  uniform highp sampler2D personAtlas;

  // 1 where nothing that was drawn into the atlas stands between the point and light i
  float visible(highp sampler2D atlas, vec4 bounds, int i, vec3 point) {
    if (bounds.w == 0.0) return 1.0;
    vec3 from = (point - bounds.xyz) / bounds.w;
    vec2 at = 0.5 + 0.5 * vec2(dot(sideways[i], from), dot(cross(towards[i], sideways[i]), from));
    if (any(lessThan(at, vec2(0.0))) || any(greaterThan(at, vec2(1.0)))) return 1.0;
    vec2 tile = vec2(float(i % ${TILES}), float(i / ${TILES}));
    float depth = min(1.0, 0.5 - 0.25 * dot(towards[i], from)); // 1 is where nothing was drawn
    return depth <= texture(atlas, (tile + at) / ${TILES}.0).r ? 1.0 : 0.0;
  }
`;

const SPHERES = /* glsl */ `
  const float PI = 3.141592653589793;
  uniform sampler2D matteMap; // irradiance / pi
  uniform vec4 plane; // unit normal and offset; normal 0 where there is no plane
  uniform vec4 own[${OWN}]; // spheres that stand for the object: centre and radius, 0 for none

  vec2 onMap(vec3 direction) {
    return vec2(atan(direction.x, -direction.z) / (2.0 * PI) + 0.5, 1.0 - acos(clamp(direction.y, -1.0, 1.0)) / PI);
  }

  // The form factor of a sphere seen from a surface: r^2 cos / d^2 where all of it is before the
  // surface, and what the surface's own plane leaves of it (Snyder 1996, MSR-TR-96-11, section 3.1).
  float formFactor(vec4 sphere, vec3 point, vec3 normal) {
    vec3 to = sphere.xyz - point;
    float h = max(length(to) / max(sphere.w, 1e-9), 1.0001); // distance in radii
    float c = dot(normalize(to), normal);
    float cut = 1.0 - h * h * c * c;
    if (cut <= 0.0) return max(0.0, c) / (h * h);
    float far = h * h - 1.0;
    float arc = acos(clamp(-c * sqrt(far / (1.0 - c * c)), -1.0, 1.0));
    return max(0.0, ((c * arc - sqrt(cut * far)) / (h * h) + atan(sqrt(cut / far))) / PI);
  }

  // What a white matt sphere sends to the point: its radiosity on the side that faces it.
  vec3 radiosity(vec4 sphere, vec3 point) {
    return PI * textureLod(matteMap, onMap(normalize(point - sphere.xyz)), 0.0).rgb;
  }

  // The share of an even sky's light that reaches a point of the plane beside the object.
  float openSky(vec3 point) {
    float open = 1.0;
    for (int k = 0; k < ${OWN}; k++) open -= formFactor(own[k], point, plane.xyz);
    return max(0.0, open);
  }
`;

const SRGB = /* glsl */ `
  vec3 decoded(vec3 c) {
    return mix(c / 12.92, pow((c + 0.055) / 1.055, vec3(2.4)), step(0.04045, c));
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

// Lambert's share of the lights, each with its shadows, and the mirrored environment: sharp at
// roughness 0, silver at 0.5, a cosine lobe at 1, in between mixed. What the map has below the plane
// gives way to the plane that the photo shows, in the object's own shade. Mirrors show other balls,
// and people as spheres with the photo on them: hair and clothes on the side that the camera sees.
export const OBJECT_FRAGMENT = /* glsl */ `
  ${LIGHTING}
  ${SPHERES}
  ${SRGB}
  ${EDIT}
  uniform vec3 baseColor;
  uniform sampler2D baseMap;
  uniform float roughness;
  uniform float metalness;
  uniform float gloss; // reflectance of the surface head-on where it is no metal
  uniform float amongPeople; // 1 for what people shade and light
  uniform float bias; // metres along the normal, against a surface shadowing itself
  uniform vec4 others[${OTHERS}]; // spheres beside the object; radius 0 for none
  uniform vec3 otherAlbedo[${OTHERS}];
  uniform int balls; // the first of them are balls, the others people
  uniform sampler2D photo;
  uniform vec4 pinhole; // focal lengths and principal point, from the lower left, as parts of the photo
  uniform sampler2D mirrorMap;
  uniform sampler2D silverMap;
  in vec3 point;
  in vec3 normalAt;
  in vec2 uvAt;
  in vec3 colorAt;
  layout(location = 0) out vec4 radiance;

  const vec3 MOST_GAIN = vec3(8.0); // of the plane over the map, which may be black there

  bool isOutside(vec4 sphere) {
    return sphere.w > 0.0 && distance(point, sphere.xyz) > 1.03 * sphere.w;
  }

  bool meetsPlane(vec3 direction) {
    return dot(plane.xyz, direction) < 0.0;
  }

  // What the plane sends along a ray that meets it: what the photo shows there, or at its edge next
  // to there, less what the object's own shade takes of an even sky's light.
  vec3 planeSeen(vec3 direction) {
    float high = max(0.0, dot(plane.xyz, point) - plane.w);
    vec3 at = point - high / dot(plane.xyz, direction) * direction;
    vec2 place = clamp(pinhole.zw + pinhole.xy * at.xy / max(-at.z, 0.05), 0.003, 0.997);
    return openSky(at) * unedited(decoded(textureLod(photo, place, 0.0).rgb));
  }

  vec3 environment(vec3 direction) {
    vec2 at = onMap(direction);
    vec3 silver = textureLod(silverMap, at, 0.0).rgb;
    return roughness < 0.5
      ? mix(textureLod(mirrorMap, at, 0.0).rgb, silver, roughness * 2.0)
      : mix(silver, textureLod(matteMap, at, 0.0).rgb, roughness * 2.0 - 1.0);
  }

  vec3 mirrored(vec3 direction) {
    float nearest = 1e9;
    vec3 seen = vec3(0.0);
    for (int k = 0; k < ${OTHERS}; k++) {
      if (!isOutside(others[k])) continue;
      vec3 to = others[k].xyz - point;
      float along = dot(to, direction);
      float inside = others[k].w * others[k].w - dot(to, to) + along * along;
      if (along <= 0.0 || inside <= 0.0 || along - sqrt(inside) >= nearest) continue;
      nearest = along - sqrt(inside);
      vec3 normal = (nearest * direction - to) / others[k].w;
      vec3 at = point + nearest * direction;
      seen = k < balls
        ? otherAlbedo[k] * textureLod(matteMap, onMap(normal), 0.0).rgb
        : unedited(decoded(textureLod(photo, pinhole.zw + pinhole.xy * at.xy / max(-at.z, 1e-3), 0.0).rgb));
    }
    if (nearest < 1e9) return seen;
    if (!meetsPlane(direction)) return environment(direction);
    vec3 sharp = planeSeen(direction);
    return mix(sharp, environment(direction), smoothstep(0.5, 1.0, roughness));
  }

  void main() {
    vec3 outward = normalize(-point); // the camera is at the origin
    vec3 n = normalize(normalAt);
    if (dot(n, outward) < 0.0) n = -n;
    vec3 color = baseColor * colorAt * texture(baseMap, uvAt).rgb;
    vec3 start = point + bias * n;
    vec3 irradiance = vec3(0.0);
    for (int i = 0; i < ${LIGHTS}; i++) {
      float cosine = dot(n, towards[i]);
      if (cosine <= 0.0) continue;
      float seen = visible(objectAtlas, objectBounds, i, start);
      if (amongPeople > 0.0) seen *= visible(personAtlas, personBounds, i, point);
      vec3 light = flux[i];
      if (meetsPlane(towards[i]))
        light *= min(planeSeen(towards[i]) / max(textureLod(mirrorMap, onMap(towards[i]), 0.0).rgb, 1e-4), MOST_GAIN);
      irradiance += light * cosine * seen;
    }
    if (amongPeople > 0.0)
      for (int k = 0; k < ${OTHERS}; k++)
        if (isOutside(others[k]))
          irradiance += otherAlbedo[k] * radiosity(others[k], point) * formFactor(others[k], point, n);
    vec3 headOn = mix(vec3(gloss), color, metalness);
    vec3 edge = max(vec3(1.0 - roughness), headOn); // Schlick, with less of it on rough surfaces
    vec3 fresnel = headOn + (edge - headOn) * pow(1.0 - abs(dot(n, outward)), 5.0) * step(1e-4, gloss + metalness);
    vec3 diffuse = color * (1.0 - metalness) / PI * irradiance;
    vec3 reflected = gloss + metalness > 0.0 ? fresnel * mirrored(reflect(-outward, n)) : vec3(0.0);
    radiance = vec4(diffuse * (1.0 - (1.0 - metalness) * fresnel) + reflected, 1.0);
  }
`;

// One quad a light: its tile, cast on the plane. Beyond it the light reaches the plane.
export const GROUND_VERTEX = /* glsl */ `
  uniform vec3 towards[${LIGHTS}];
  uniform vec3 corners[${4 * LIGHTS}];
  uniform vec4 plane;
  flat out int light;
  out vec3 point;
  void main() {
    light = gl_InstanceID;
    point = corners[4 * gl_InstanceID + gl_VertexID];
    bool reaches = dot(plane.xyz, towards[light]) > ${GRAZING};
    gl_Position = reaches ? projectionMatrix * viewMatrix * vec4(point, 1.0) : vec4(2.0);
  }
`;

const GROUND = /* glsl */ `
  ${LIGHTING}
  uniform vec4 plane;
  flat in int light;
  in vec3 point;
  layout(location = 0) out vec4 blocked; // irradiance that the object keeps from the plane
  layout(location = 1) out vec4 before; // and what people already kept from it
`;

export const OBJECT_ON_GROUND_FRAGMENT = /* glsl */ `
  ${GROUND}
  uniform float sink; // metres below the plane, so that the object's own foot shades it
  void main() {
    float shade = 1.0 - visible(objectAtlas, objectBounds, light, point - sink * plane.xyz);
    if (shade > 0.0) shade *= visible(personAtlas, personBounds, light, point);
    blocked = vec4(flux[light] * dot(plane.xyz, towards[light]) * shade, 0.0);
    before = vec4(0.0);
  }
`;

export const PERSON_ON_GROUND_FRAGMENT = /* glsl */ `
  ${GROUND}
  void main() {
    float shade = 1.0 - visible(personAtlas, personBounds, light, point);
    blocked = vec4(0.0);
    before = vec4(flux[light] * dot(plane.xyz, towards[light]) * shade, 0.0);
  }
`;

// One quad a sphere: the light that the object reflects to the plane, less than nothing blocked.
export const BOUNCE_VERTEX = /* glsl */ `
  ${SPHERES}
  flat out int sphere;
  out vec3 point;
  void main() {
    sphere = gl_InstanceID;
    vec4 from = own[sphere];
    vec3 across = normalize(cross(plane.xyz, vec3(0.0, 0.0, 1.0)));
    vec3 along = cross(plane.xyz, across);
    vec3 foot = from.xyz - (dot(plane.xyz, from.xyz) - plane.w) * plane.xyz;
    point = foot + ${BOUNCE_RADII} * from.w * (position.x * across + position.y * along);
    gl_Position = from.w > 0.0 ? projectionMatrix * viewMatrix * vec4(point, 1.0) : vec4(2.0);
  }
`;

export const BOUNCE_FRAGMENT = /* glsl */ `
  ${SPHERES}
  uniform vec3 ownAlbedo[${OWN}];
  flat in int sphere;
  in vec3 point;
  layout(location = 0) out vec4 blocked;
  layout(location = 1) out vec4 before;
  void main() {
    float factor = formFactor(own[sphere], point, plane.xyz);
    blocked = vec4(-ownAlbedo[sphere] * radiosity(own[sphere], point) * factor * (1.0 - factor), 0.0);
    before = vec4(0.0);
  }
`;

// Only its depth counts; outputs for both targets of the plane.
export const DEPTH_VERTEX = /* glsl */ `
  void main() {
    gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  }
`;
export const DEPTH_FRAGMENT = /* glsl */ `
  layout(location = 0) out vec4 first;
  layout(location = 1) out vec4 second;
  void main() {
    first = second = vec4(0.0);
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
  uniform sampler2D blockedSum;
  uniform sampler2D beforeSum;
  uniform sampler2D object;
  uniform sampler2D blocked;
  uniform sampler2D before;
  in vec2 at;
  layout(location = 0) out vec4 newObjectSum;
  layout(location = 1) out vec4 newBlockedSum;
  layout(location = 2) out vec4 newBeforeSum;
  void main() {
    newObjectSum = texture(objectSum, at) + texture(object, at);
    newBlockedSum = texture(blockedSum, at) + texture(blocked, at);
    newBeforeSum = texture(beforeSum, at) + texture(before, at);
  }
`;

// object + (1 - coverage) photo x (irradiance with the object / without), of what the camera saw, edited
// as the photo is, then sRGB
export const PHOTO_FRAGMENT = /* glsl */ `
  uniform sampler2D objectSum;
  uniform sampler2D blockedSum;
  uniform sampler2D beforeSum;
  uniform sampler2D photo;
  uniform vec3 unshadowed;
  uniform float batches;
  in vec2 at;
  layout(location = 0) out vec4 shown;

  ${SRGB}
  ${EDIT}
  vec3 encoded(vec3 c) {
    c = clamp(c, 0.0, 1.0);
    return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
  }

  void main() {
    vec3 seen = decoded(texture(photo, at).rgb);
    if (batches > 0.0) {
      vec4 front = texture(objectSum, at) / batches;
      vec3 without = unshadowed - texture(beforeSum, at).rgb;
      vec3 blocked = texture(blockedSum, at).rgb / max(without, 1e-3 * unshadowed + 1e-20);
      vec3 scene = unedited(seen);
      seen += edited(front.rgb + (1.0 - front.a) * scene * clamp(1.0 - blocked, 0.0, 4.0)) - edited(scene);
    }
    shown = vec4(encoded(seen), 1.0);
  }
`;
