"""Write web/packages/client/src/drivers/stages.generated.ts: the film's backdrops, as numbers for the pages.

python scripts/make_stages.py           # after a change of src/echoavatar/files/avatar/backdrop.py; then `make web`
"""

import json
from pathlib import Path

from echoavatar.files.avatar.backdrop import BACKDROPS, TONE

TARGET = Path(__file__).parents[1] / "web" / "packages" / "client" / "src" / "drivers" / "stages.generated.ts"
ROWS = ("direction", "key", "sky", "ground", "behind", "rim")
HEAD = """/** The backdrops of the film. Do not edit: scripts/make_stages.py makes it of the film's backdrop.py. */

export type Triple = readonly [number, number, number];

/** Directions are unit vectors, light is linear, backdrops are sRGB from 0 to 1. */
export interface Stage {
  readonly direction: Triple; // to the key light
  readonly key: Triple;
  readonly sky: Triple;
  readonly ground: Triple;
  readonly behind: Triple; // direction to the light from behind
  readonly rim: Triple;
  readonly top: Triple;
  readonly horizon: Triple;
  readonly bottom: Triple;
  readonly shadow: readonly [cast: number, contact: number];
}

"""


def text() -> str:
    """The file."""
    lines = [HEAD, f"export const TONE = {json.dumps(TONE)} as const; // x (a x + b) / (x (c x + d) + e)\n\n"]
    lines += ["export const STAGES = {\n"]
    for name, backdrop in BACKDROPS.items():
        rows = zip(ROWS, backdrop.look, strict=True)
        numbers = {row: [round(float(value), 4) for value in values] for row, values in rows}
        for part in ("top", "horizon", "bottom"):
            numbers[part] = [round(value / 255, 4) for value in getattr(backdrop, part)]
        numbers["shadow"] = list(backdrop.shadow)
        lines += [
            f"  {name}: {{\n",
            *(f"    {key}: {json.dumps(value)},\n" for key, value in numbers.items()),
            "  },\n",
        ]
    return "".join([*lines, "} as const satisfies Record<string, Stage>;\n"])


if __name__ == "__main__":
    TARGET.write_text(text(), "utf-8")
