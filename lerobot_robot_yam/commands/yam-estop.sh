#!/bin/sh
# Start yam-estop without Python's site packages and without this package's own __init__: they take ten times as long as
# the emergency stop itself. The build installs this script as `yam-estop`, beside the environment's `python`.
self=$0
[ -h "$self" ] && self=$(readlink -f "$self")
bin=${self%/*}
python=$bin/python
[ -x "$python" ] || python=python3
for packages in "$bin"/../lib/python3.*/site-packages; do
  editable=$packages/_editable_impl_lerobot_robot_yam.pth # names the clone, if a clone is installed
  if [ -r "$editable" ]; then IFS= read -r packages <"$editable"; fi
  if [ -r "$packages/lerobot_robot_yam/commands/estop.py" ]; then
    exec "$python" -I -S -c '
import sys
light = type(sys)("lerobot_robot_yam")
light.__path__ = [sys.argv.pop(1)]
sys.modules["lerobot_robot_yam"] = light
from lerobot_robot_yam.commands.estop import main
sys.exit(main())' "$packages/lerobot_robot_yam" "$@"
  fi
done
exec "$python" -P -m lerobot_robot_yam.commands.estop "$@"
