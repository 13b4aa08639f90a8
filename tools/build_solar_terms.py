"""Write the periodic terms of the sun's position: skylight/skies/data/solar_terms.json.

    python tools/build_solar_terms.py

Reads the tables of Reda & Andreas (2004) from pvlib, which has them as published; the package needs
pvlib no longer then.
"""

import json
from pathlib import Path

from pvlib import spa

OUT = Path(__file__).resolve().parents[1] / "skylight" / "skies" / "data" / "solar_terms.json"


def main() -> None:
    terms = {
        "longitude": [spa.L0, spa.L1, spa.L2, spa.L3, spa.L4, spa.L5],
        "latitude": [spa.B0, spa.B1],
        "radius": [spa.R0, spa.R1, spa.R2, spa.R3, spa.R4],
    }
    content = {name: [table.tolist() for table in tables] for name, tables in terms.items()}
    content["nutation"] = spa.NUTATION_ABCD_ARRAY.tolist()
    content["nutation_arguments"] = spa.NUTATION_YTERM_ARRAY.tolist()
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(content, separators=(",", ":")).replace("],[", "],\n[") + "\n")


if __name__ == "__main__":
    main()
