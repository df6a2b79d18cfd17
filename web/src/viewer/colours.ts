/** Colour maps, the same as in the report's pictures: readable with every kind of colour vision. */

// 33 colours of matplotlib's maps (CC0), evenly spaced; between them is interpolated.
const TABLES = {
  viridis:
    "440154470d6048186a482374472d7b4537814240863e49893b528b375b8d33638d2f6b8e2c728e297a8e26828e23898e21918c1f988b1fa08822a78528ae8032b67a3fbc734ec36b5ec96270cf5784d44b98d83eaddc30c2df23d8e219ece51bfde725",
  cividis:
    "00224e00285b002e6a0533711a386f273e6e32436d3b496c434e6c4b546c535a6d5a5f6e61656f686a716f70737676767d7c788482798c8878938e789b9476a39a74aba072b4a76fbcae6cc4b468cdbb63d5c25edec958e7d150f0d846f9e03afee838",
  magma:
    "0000040303120a0822130d341d114729115a36106b440f7651127c5d177f6a1c81762181832681902a819c2e7faa337db73779c43c75d0416fdc4869e75263ef5d5ef56b5cf9795dfc8961fd9869fea772feb67cfec488fed395fde2a3fcf0b2fcfdbf",
} as const;

export type ColourMapName = keyof typeof TABLES;

/** Return 256 colours, r g b from 0 to 255. */
export function colourTable(name: ColourMapName): Uint8Array {
  const text = TABLES[name];
  const stops = text.length / 6 - 1;
  const table = new Uint8Array(256 * 3);
  for (let i = 0; i < 256; i++) {
    const place = (i / 255) * stops;
    const first = Math.min(Math.floor(place), stops - 1);
    for (let channel = 0; channel < 3; channel++) {
      const at = (stop: number): number => parseInt(text.substr(6 * stop + 2 * channel, 2), 16);
      table[3 * i + channel] = Math.round(at(first) + (place - first) * (at(first + 1) - at(first)));
    }
  }
  return table;
}

/** What colours show. */
export type ColourBy = "micrograph" | "height" | "sigma" | "views";

/** A range of values with their colours, for the surface, the map and the colour bar. */
export interface Colouring {
  by: ColourBy;
  /** What the colour bar says. */
  title: string;
  /** Heights, codes of the uncertainty, or numbers of views. */
  low: number;
  high: number;
  /** 256 colours from low to high. */
  table: Uint8Array;
  /** Where the colour bar is labelled. */
  marks: { at: number; text: string }[];
  /** Values that are whole numbers: the bar has steps. */
  steps: boolean;
}
