"""The loops of the machine's process and of the preview's: mail in, a step, mail out."""

import gc
from collections.abc import Callable
from typing import Protocol

from workgauge.rehearse.station.previewing import Previewer
from workgauge.rehearse.station.station import Station
from workgauge.values.errors import WireError
from workgauge.values.mail import Mail
from workgauge.values.station import PreviewTask, Setup, Snapshot
from workgauge.wire.station import decode_station, encode_station, topic

#: Letters taken in per tick: what comes faster waits, and in the end is dropped.
INTENTS, REQUESTS, PREVIEWS = 64, 64, 4
#: The setup is told so often [ticks], for whoever comes later.
SETUP_EVERY_S = 1.0


class Pacing(Protocol):
    """A fixed period."""

    late: int

    def wait(self) -> int:
        """Wait until the next period begins; return when it does [ns]."""
        ...


def _tell(station: Station, mail: Mail, name: str, value: Snapshot | Setup | PreviewTask, number: int = 0) -> None:
    """Publish what a station has to say; what cannot be written is an event, and the machine goes on without it.

    Pages that see nothing new any more have their hands refused.
    """
    try:
        frame = encode_station(value, number)
    except WireError as error:
        said, events = f"the {name} cannot be told: {error}", station.told.events
        if not events or events[-1].text != said:
            station.event(said)
        return
    mail.publish(topic(station.session.machine_id, name), frame)


def run_station(station: Station, mail: Mail, pace: Pacing, going: Callable[[], bool]) -> None:
    """Step a machine until told to stop. Garbage is collected between ticks only; the old
    generation where the machine was put back to its start, else never."""
    name = station.session.machine_id
    intents = mail.inbox(topic(name, "intent"), INTENTS)
    requests = mail.inbox(topic(name, "request"), 8 * REQUESTS)
    previews = mail.inbox(topic(name, "preview-result"), PREVIEWS)
    told_ns: int | None = None
    session = station.session
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        while going():
            now_ns = pace.wait()
            station.desk.lost(intents.lost + requests.lost)
            snapshot = station.step(
                *(now_ns, intents.read(INTENTS), requests.read(REQUESTS), previews.read(PREVIEWS)), late=pace.late
            )
            if station.session is not session:  # put back to the start: the old one goes now, or never
                session = station.session
                gc.collect()
            for task in station.tasks():
                _tell(station, mail, "preview-task", task)
            if snapshot is not None:
                _tell(station, mail, "snapshot", snapshot, snapshot.number)
            if told_ns is None or now_ns - told_ns >= SETUP_EVERY_S * 1e9:
                _tell(station, mail, "setup", station.setup(now_ns))
                told_ns = now_ns
                gc.collect(0)
    finally:
        gc.enable()
        gc.unfreeze()


def run_previews(previewer: Previewer, mail: Mail, wait: Callable[[], object], going: Callable[[], bool]) -> None:
    """Look at one goal after the other until told to stop; of several waiting, only the newest."""
    name = previewer.machine_id
    tasks = mail.inbox(topic(name, "preview-task"), 1)
    while going():
        letters = tasks.read()
        if not letters:
            wait()
            continue
        try:
            task = decode_station(letters[-1].data, letters[-1].received_ns).value
        except WireError:
            continue
        if isinstance(task, PreviewTask):
            mail.publish(topic(name, "preview-result"), encode_station(previewer.look(task)))
