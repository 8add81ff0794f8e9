"""What may be asked of a running machine, and what becomes of it: one method per kind of request."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from workgauge.rehearse.choices import chosen_guard
from workgauge.rehearse.station.telling import NOT_OFFERED, THRESHOLDS
from workgauge.values.errors import InputError
from workgauge.values.station import PreviewTask, Request, RequestKind

if TYPE_CHECKING:
    from workgauge.rehearse.station.station import Station


class Asking:
    """Does what a station is asked, or answers why not."""

    def __init__(self, station: "Station") -> None:
        self._station = station
        self._ways: dict[RequestKind, Callable[[Request, int], str]] = {
            RequestKind.TAKE: self._take,
            RequestKind.GIVE: self._give,
            RequestKind.LEAVE: self._leave,
            RequestKind.STOP: self._stop,
            RequestKind.CLEAR: self._clear,
            RequestKind.STATE: self._state,
            RequestKind.GUARD: self._guard,
            RequestKind.PLAY: self._play,
            RequestKind.PAUSE: self._pause,
            RequestKind.RESTART: self._restart,
            RequestKind.PREVIEW: self._preview,
            RequestKind.RUN: self._run,
            RequestKind.CANCEL: self._cancel,
            RequestKind.OVERRIDE: self._override,
        }
        self.tasks: list[PreviewTask] = []

    def take(self, request: Request, now_ns: int) -> None:
        """Do what is asked, and answer."""
        station = self._station
        refused = station.desk.may(request)
        if not refused:
            try:
                refused = self._ways[request.kind](request, now_ns)
            except InputError as error:
                refused = str(error)
        station.told.answer(request.stamp.source, request.id, not refused, refused)

    def _take(self, request: Request, now_ns: int) -> str:
        desk, source = self._station.desk, request.stamp.source
        if desk.driver and desk.driver != source:
            desk.wanted_by = source
            self._station.event(f"{source} asks {desk.driver} for the driver's seat")
            return "somebody drives: they have been told that you want to"
        self._station.stop_playing()
        if desk.driver != source:
            self._station.goals.cancel()
            desk.seat(source, now_ns)
            self._station.event(f"{source} takes the driver's seat")
        return ""

    def _give(self, request: Request, now_ns: int) -> str:
        desk = self._station.desk
        if not request.text or request.text != desk.wanted_by:
            return "nobody of that name asked for the seat"
        self._station.goals.cancel()
        desk.seat(request.text, now_ns)
        self._station.event(f"{request.stamp.source} hands the driver's seat over to {request.text}")
        return ""

    def _leave(self, request: Request, now_ns: int) -> str:
        desk = self._station.desk
        if desk.wanted_by == request.stamp.source:
            desk.wanted_by = ""
        if desk.driver == request.stamp.source:
            self._station.goals.cancel()
            desk.seat("", now_ns)
            self._station.event(f"{request.stamp.source} leaves the driver's seat")
        return ""

    def _stop(self, request: Request, now_ns: int) -> str:
        self._station.stop(request.stamp.source)
        return ""

    def _clear(self, request: Request, now_ns: int) -> str:
        if self._station.stopped:
            self._station.stopped = ""
            self._station.event(f"stop cleared by {request.stamp.source}")
        return ""

    def _state(self, request: Request, now_ns: int) -> str:
        if request.on is None:
            return "on or off?"
        session = self._station.session
        session.set_state(request.text, request.on)
        self._station.event(f"{request.text}: {'on' if request.on else 'off'}, by {request.stamp.source}")
        return ""

    def _guard(self, request: Request, now_ns: int) -> str:
        station = self._station
        if request.text in NOT_OFFERED:
            return "this guard keeps nothing"
        settings = dict(request.settings)
        for name, value in settings.items():
            if name not in THRESHOLDS or not THRESHOLDS[name][0] <= value <= THRESHOLDS[name][1]:
                allowed = ", ".join(f"{key} {low:g} to {high:g}" for key, (low, high) in THRESHOLDS.items())
                return f"{name} cannot be {value:g}: {allowed} m"
        if not station.standing:
            return "the guard is chosen while the machine stands still"
        station.choose_guard(chosen_guard(request.text, settings))
        said = "".join(f", {name} {value:g}" for name, value in settings.items())
        station.event(f"guard {request.text}{said}, by {request.stamp.source}")
        return ""

    def _play(self, request: Request, now_ns: int) -> str:
        if self._station.stopped:
            return f"{self._station.stopped}: clear the stop first"
        self._station.play()
        self._station.event(f"scenario played by {request.stamp.source}")
        return ""

    def _pause(self, request: Request, now_ns: int) -> str:
        paused = request.on is not False
        if paused != self._station.paused:
            self._station.paused = paused
            self._station.event(f"{'paused' if paused else 'goes on'}, by {request.stamp.source}")
        return ""

    def _restart(self, request: Request, now_ns: int) -> str:
        self._station.restart()
        return ""

    def _preview(self, request: Request, now_ns: int) -> str:
        station = self._station
        if not request.text or len(request.text) > 40:
            return "a preview needs an id of at most 40 letters"
        wrong = station.goals.wrong(request.numbers)
        if wrong:
            return wrong
        if not station.standing:
            return "a goal is looked at while the machine stands still"
        self.tasks.append(station.goals.ask(request.stamp, request.text, request.numbers, request.on is not False))
        return ""

    def _run(self, request: Request, now_ns: int) -> str:
        refused = self._station.goals.run(request.text)
        if not refused:
            self._station.event(f"goal begun by {request.stamp.source}")
        return refused

    def _cancel(self, request: Request, now_ns: int) -> str:
        self._station.goals.cancel()
        return ""

    def _override(self, request: Request, now_ns: int) -> str:
        station, by = self._station, request.stamp.source
        limit, minutes, reason = request.text, request.number, request.reason
        refused = station.suspensions.refused(limit, minutes, reason)
        if refused or minutes is None:
            return refused
        station.suspensions.suspend(station.session, limit, minutes, reason, by)
        name = station.names.name(limit)
        if minutes:
            station.event(f"{name} SUSPENDED for {minutes:g} minutes by {by}: {reason.strip()}")
        else:
            station.event(f"{name} put back in force by {by}")
        return ""
