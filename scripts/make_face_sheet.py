"""Contact sheet of the character's 52 face shapes: `python scripts/make_face_sheet.py [OUT]` (extra `render`)."""

import sys
from pathlib import Path

from echoavatar.avatar.sheet import face_sheet, save_picture

SHIPPED = Path(__file__).parents[1] / "docs" / "img" / "face_shapes.jpg"

if __name__ == "__main__":
    out = Path(sys.argv[1]) if len(sys.argv) > 1 else SHIPPED
    out.parent.mkdir(parents=True, exist_ok=True)
    save_picture(out, face_sheet())
    print(f"{out}: {out.stat().st_size} bytes")
