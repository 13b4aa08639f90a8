import type { Edit } from "../../shared/edit";
import { readTensors } from "./tensors";

type Rgb = [number, number, number];

/** What skylight.studio.tasks._portrait says of a person; its text tells the fields. */
export interface Facts {
  command: string;
  is_alone: boolean;
  warning: string;
  size: [width: number, height: number];
  crop: [left: number, top: number, width: number, height: number];
  /** Azimuth and elevation in degrees, 0 at the camera and positive to the viewer's right. */
  keys: Record<string, [azimuth: number, elevation: number]>;
  usual: { size_deg: number; strength: number };
  fill: number;
  ball: number;
  gloss: number;
  lobe: { f0: number; alpha: number };
  sigmas_px: [sharp: number, reach: number, around: number];
  /** Of skin: what hollows receive of the face, and its colour. */
  albedo: number;
  hue: Rgb;
  /** Along which skin near white has strayed from the line from usual skin to white. */
  across: Rgb;
  near: number;
  base: number;
  shine: number;
  most: [brighter: number, darker: number];
  /** What is no skin. */
  other_most: [brighter: number, darker: number];
  /** The logarithm that is 0 of the marks' second number. */
  darkest: number;
  veil: number;
  room: [begins: number, round: number];
  /** Over how much a gain bends at least. */
  bend: number;
  edge_of_white: number;
  over: number;
  /** What skin lacks of its usual colour, by its brightness, and the change of level that soon shows it. */
  lacks: Rgb[];
  soon: number;
  /** Of a key behind the sitter: skylight.portrait._edge. */
  behind: number;
  metered: number;
  rim: number;
  /** The colour of its lamp on what is shiny, and how bright white is in the photograph's light. */
  lamp_shine: Rgb;
  lit: number;
  stray: number;
  most_strand: number;
  /** Times its own colour, of surfaces and of hair, which is soon as bright as it gets. */
  sent: [surface: number, hair: number];
  soon_lit: number;
  unseen: number;
  doubted: number;
  doubts: string[];
  knee: number;
  edit: Edit;
}

/** The points of a person's surface (m of them) in the light found and in the fill; row by row. */
export interface Person {
  facts: Facts;
  picture: { width: number; height: number; codes: Uint8Array };
  /** Four a pixel: what is not seen of the old light, the picture's base, how much is skin, and how far it is told from what is behind. */
  marks: Uint8Array;
  places: Int32Array;
  normals: Float32Array;
  views: Float32Array;
  visible: Uint8Array;
  shading: Float32Array;
  glossy: Float32Array;
  /** By the fill, over how bright it makes the ball; one number a point. */
  occlusion: Float32Array;
  fillGloss: Float32Array;
  bare: Float32Array;
  face: Float32Array;
  /** How much of a pixel of the crop is the face's. */
  share: Float32Array;
  /** Four a pixel of the crop: how the outline leans to the right, and up; how far it has the colour of skin; how bright the person is around. */
  outline: Float32Array;
  /** Three a pixel of the crop: how much of it is a surface, and hair, that a lamp behind lights; how glossy it is. */
  reflecting: Float32Array;
  /** Four a pixel of the crop, logarithms: what highlights have too much of each channel; how far white skin has strayed along `across`. */
  pale: Float32Array;
  foundPower: Float32Array;
  foundMap: { width: number; height: number; data: Float32Array };
}

export function readPerson(file: ArrayBuffer): Person {
  const tensors = readTensors(file);
  const sized = (name: string): { width: number; height: number } => {
    const [height, width] = tensors.shape(name) as [number, number];
    return { width, height };
  };
  return {
    facts: JSON.parse(tensors.text("facts")) as Facts,
    picture: { ...sized("picture"), codes: tensors.bytes("picture") },
    marks: tensors.bytes("marks"),
    places: tensors.integers("places"),
    normals: tensors.floats("normals"),
    views: tensors.floats("views"),
    visible: tensors.bytes("visible"),
    shading: tensors.floats("shading"),
    glossy: tensors.floats("glossy"),
    occlusion: tensors.floats("occlusion"),
    fillGloss: tensors.floats("fill_gloss"),
    bare: tensors.floats("bare"),
    face: tensors.floats("face"),
    share: tensors.floats("share"),
    outline: tensors.floats("outline"),
    reflecting: tensors.floats("reflecting"),
    pale: tensors.floats("pale"),
    foundPower: tensors.floats("found_power"),
    foundMap: { ...sized("found_map"), data: tensors.floats("found_map") },
  };
}
