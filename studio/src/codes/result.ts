/** What a job of kind "code" answers. Angles in degrees. */
export interface CodeResult {
  counts: number[];
  errors: number[];
  floats: number;
  map_floats: number;
  /** The strongest first. */
  activations: Activation[];
}

export interface Activation {
  azimuth_deg: number;
  zenith_deg: number;
  weight: [number, number, number];
  width_deg: number;
  length_deg: number;
  /** Where the filter has half its height: [azimuth, zenith]; empty for a pixel or a constant. */
  outline: [number, number][];
}
