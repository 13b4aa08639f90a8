/** What was done to a photo after its light was measured; `pivot` in its linear values. */
export interface Edit {
  saturation: number;
  contrast: number;
  pivot: number;
}

/** GLSL of skylight.imaging._edits; `edit` is (saturation, contrast, pivot). */
export const EDIT = /* glsl */ `
  uniform vec3 edit;

  vec3 edited(vec3 linear) {
    if (edit.xy == vec2(1.0)) return linear;
    vec3 c = pow(max(linear / edit.z, 1e-6), vec3(1.0 / 2.2));
    float luma = dot(c, vec3(0.2126, 0.7152, 0.0722));
    return edit.z * pow(max(1.0 + edit.y * (luma - 1.0) + edit.x * (c - luma), 0.0), vec3(2.2));
  }
  vec3 unedited(vec3 shown) {
    if (edit.xy == vec2(1.0)) return shown;
    vec3 c = pow(max(shown / edit.z, 0.0), vec3(1.0 / 2.2));
    float luma = dot(c, vec3(0.2126, 0.7152, 0.0722));
    return edit.z * pow(max(1.0 + (luma - 1.0) / edit.y + (c - luma) / edit.x, 0.0), vec3(2.2));
  }
`;
