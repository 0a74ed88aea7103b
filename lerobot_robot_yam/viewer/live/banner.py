"""What nobody may overlook: a bar over the top of the whole page, wherever its panels are, and its title."""

import json
from collections.abc import Sequence

import viser
import viser._messages

_BEAT_S = 1.0
_SILENT_S = 4.0
_SILENT = "NO WORD FROM yam-view: what this page shows is old. Stop the arms with their own emergency stop."

# `lines` stands before it. The browser's own timer says when this page is no longer brought up to date.
_SHOW = """
let bar = document.getElementById("yam-banner");
if (!bar) {
  bar = document.createElement("div");
  bar.id = "yam-banner";
  bar.setAttribute("role", "alert");
  bar.style.cssText = "position:fixed;top:0;left:0;right:0;z-index:100000;max-height:40vh;overflow:hidden;"
    + "background:#c00;color:#fff;font:bold 17px/1.4 sans-serif;padding:0.5em 1em;text-align:center;"
    + "white-space:pre-line;pointer-events:none;box-shadow:0 2px 8px rgba(0,0,0,0.5)";
  document.body.append(bar);
}
const show = (lines) => {
  const text = lines.join("\\n");
  if (bar.textContent !== text) bar.textContent = text;
  bar.style.display = text ? "block" : "none";
  document.title = (text ? "(!) " : "") + "yam-view";
};
show(lines);
clearTimeout(window.yamSilence);
window.yamSilence = setTimeout(() => show([silent, ...lines]), silentMs);
"""


class RunJavascriptMessage(viser._messages.RunJavascriptMessage, include_in_scene_serialization=False):
    """viser's message of that name. viser keeps each for browsers that come later; of this one only the newest."""

    def redundancy_key(self) -> str:
        """The same for all."""
        return "yam-view banner"


class Banner:
    """The bar of all browsers.

    Args:
        server: viser's.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._lines: list[str] = []
        self._sent_s = -_BEAT_S

    def show(self, lines: Sequence[str], now_s: float) -> None:
        """Show these lines; none: no bar. Call it often: a browser that hears nothing for 4 s says so itself."""
        if list(lines) == self._lines and now_s - self._sent_s < _BEAT_S:
            return
        self._lines, self._sent_s = list(lines), now_s
        values = {"lines": self._lines, "silent": _SILENT, "silentMs": round(_SILENT_S * 1e3)}
        head = "".join(f"const {name} = {json.dumps(value)};" for name, value in values.items())
        self._server._websock_server.queue_message(RunJavascriptMessage(head + _SHOW))
