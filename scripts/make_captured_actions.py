"""Cut the captured actions of the library out of recordings; run after editing their list.

Run `python scripts/make_captured_actions.py FOLDER` with a folder that holds `gesture_units.csv` and the files that
it names; then `echoavatar actions build --model src/echoavatar/bundles/default`.
"""

import sys
from pathlib import Path

from echoavatar_lab.corpora.rehearsal.captured_actions import TABLE, cut_actions, save

if __name__ == "__main__":
    save(cut_actions(Path(sys.argv[1])))
    print(f"{TABLE}: {TABLE.stat().st_size:,} bytes")
