"""The recorder's buttons."""

from __future__ import annotations

from valor.bags import recordings
from valor.common.errors import RefusalError
from valor.common.linking import behind
from valor.common.messages import MarkRequest, SnapRequest
from valor.common.topics import MARK, SNAP
from valor.operator_station.desk import Visit
from valor.operator_station.parts import Parts
from valor.operator_station.worker import Worker
from valor.service import Context

BEHIND = "Not here: the operator is behind the link, the recorder is asked over Bifrost, which is not carried."


class Extras:
    """Its buttons, and what they do."""

    def __init__(self, parts: Parts, context: Context, worker: Worker) -> None:
        gui, desk = parts.server.gui, parts.desk
        self._node, self._instance = context.node, context.instance
        linked = behind(context.settings)
        with gui.add_folder("Recorder"):
            if linked:
                gui.add_markdown(BEHIND)
            for label, act in (("Snap: save the last seconds", self._snap), ("Keep this recording", self._keep)):
                gui.add_button(label, disabled=linked).on_click(desk.taking(worker.doing(label.lower(), act)))
            text = gui.add_text("mark", "", hint="a line that stands at this moment of the recording")
            button = gui.add_button("Mark this moment", disabled=linked)

        def mark(visit: Visit) -> None:
            words = str(text.value).strip() or "here"
            worker.do(visit, f"mark {words!r}", lambda: self._mark(words))

        button.on_click(desk.taking(mark))

    def _mark(self, text: str) -> str:
        reply = MARK.client(self._node).call(MarkRequest(text), timeout=2.0)
        if not reply.accepted:
            raise RefusalError("mark", reply.reason)
        return "marked"

    def _snap(self) -> str:
        reply = SNAP.client(self._node).call(SnapRequest(), timeout=60.0)
        if not reply.accepted:
            raise RefusalError("snap", reply.reason)
        return "saved"

    def _keep(self) -> str:
        found = recordings.look(self._instance.bags)
        if not found:
            raise RefusalError("keep", f"no recording in {self._instance.bags}")
        newest = max(found, key=lambda each: each.begun)
        recordings.keep(newest, True)
        return f"{newest.name} stays"
