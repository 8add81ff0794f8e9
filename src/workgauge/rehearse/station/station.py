"""A machine that runs: one step per tick of the real clock, snapshots out, intents and requests in."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from workgauge.gauge.suspending import may_suspend
from workgauge.guard.api import Guard
from workgauge.loop.warm import warm_up
from workgauge.motion.job import Job, JobFacts
from workgauge.rehearse.run import open_session
from workgauge.rehearse.scenario_file import LoadedScenario
from workgauge.rehearse.session import Session
from workgauge.rehearse.station import telling
from workgauge.rehearse.station.asking import Asking
from workgauge.rehearse.station.coasting import Coasting
from workgauge.rehearse.station.desk import Desk, DeskSettings
from workgauge.rehearse.station.goals import Goals
from workgauge.rehearse.station.playing import Player
from workgauge.rehearse.station.suspensions import Suspensions
from workgauge.rehearse.step_result import StepResult
from workgauge.values.errors import InputError
from workgauge.values.mail import Letter
from workgauge.values.measurements import DriveMode, Intent, Levers, Stamp
from workgauge.values.station import Answer, Event, Held, PreviewTask, Setup, Snapshot

#: Snapshots go out no closer together than this [s].
SNAPSHOT_S = 0.04
#: So many answers and events are told, the newest; so long a tick's time counts in what is told of it [ticks].
ANSWERS, EVENTS, TIMES = 8, 30, 100
SOURCE = "machine"


@dataclass(slots=True)
class Told:
    """What is to be told once: answers and events."""

    answers: list[Answer] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def answer(self, to: str, request: str, done: bool, text: str) -> None:
        """Answer a request."""
        self.answers = [*self.answers, Answer(to, request, done, text)][-ANSWERS:]

    def event(self, t_s: float, text: str) -> None:
        """Note something that happened."""
        self.events = [*self.events, Event(round(t_s, 3), text)][-EVENTS:]


class Station:
    """One machine and who drives it. `step` is called once a tick.

    Args:
        loaded: the scenario it stands in. settings: of the driver's link. log: is told every event as it happens.

    Raises:
        InputError: if the scenario cannot be used.
    """

    def __init__(
        self, loaded: LoadedScenario, settings: DeskSettings | None = None, log: Callable[[str], None] | None = None
    ) -> None:
        self._loaded, self._log = loaded, log
        self.settings = settings or DeskSettings()
        self.told = Told()
        self._number = 0
        self.stopped = ""  #: by whom, until the driver clears it: neither a new start nor the scenario does
        self._drove = ""
        self._open()
        self.desk = Desk(self.session.machine_id, self.settings)
        self._asking = Asking(self)

    def _open(self) -> None:
        """Put the machine where the scenario has it."""
        self.session: Session = open_session(self._loaded, intent_age_s=self.settings.intent_age_s)
        warm_up(self.session.config)
        self.names = telling.Names({limit.id: limit for limit in self.session.limit_set.limits})
        self.player: Player | None = None
        self._anew = False
        self.paused = False
        self.goals = Goals(self.session)
        self._coasting = Coasting(self.session)
        self.suspensions = Suspensions(may_suspend(self.session.limit_set.limits, self.session.rules))
        self._done: StepResult | None = None
        self._levers = Levers()
        self._times: list[float] = []
        self._snapshot_ns: int | None = None

    def event(self, text: str) -> None:
        """Note something that happened."""
        self.told.event(self.session.t_s, text)
        if self._log is not None:
            self._log(f"{self.session.t_s:.3f} s: {text}")

    def choose_guard(self, guard: Guard) -> None:
        """Let another guard work.

        Raises:
            ScenarioError: unless the machine stands still.
        """
        self.session.choose_guard(guard)
        warm_up(self.session.config)
        self.goals.cancel()

    def tasks(self) -> list[PreviewTask]:
        """Return the previews asked for since the last call."""
        found, self._asking.tasks = self._asking.tasks, []
        return found

    def restart(self) -> None:
        """Put the machine back where it began: a simulated one can be; the driver keeps the seat."""
        self._open()
        self.event("put back to the start")

    def play(self) -> None:
        """Let the scenario drive, from its beginning.

        Raises:
            InputError: if one of its steps cannot be done.
        """
        self._open()
        self.player = Player(self.session, self._loaded.scenario)
        self.event("scenario begins")

    def stop_playing(self) -> None:
        """Take the hands of the scenario away; whoever has the seat must let go and press Enable to go on."""
        if self.player is not None:
            self.player, self._anew = None, True
            self.session.travel(0.0)
            self.event("scenario ends")

    def stop(self, by: str) -> None:
        """Let nothing move the machine until the stop is cleared, Enable let go and pressed again."""
        if not self.stopped:
            self.stopped = f"stopped by {by}"
            self.event(self.stopped)
        self._anew = True
        self.stop_playing()
        self.goals.cancel()

    @property
    def standing(self) -> bool:
        """Whether every valve is closed and the undercarriage stands."""
        done = self._done
        return (done is None or not any(done.trace.valves)) and not self.session.true_travel[0]

    def step(
        self,
        now_ns: int,
        intents: Sequence[Letter] = (),
        requests: Sequence[Letter] = (),
        previews: Sequence[Letter] = (),
        *,
        late: int = 0,
    ) -> Snapshot | None:
        """Advance one tick, unless paused; return a snapshot if one is due.

        Args:
            now_ns: the real clock. late: ticks begun late so far, to be told.
        """
        desk = self.desk
        desk.take_intents(intents, now_ns)
        for request in desk.take_requests(requests, now_ns):
            self._asking.take(request, now_ns)
        for letter in previews:
            self.goals.found(letter)
        gone = desk.watch_seat(now_ns)
        if gone:
            self.event(f"{gone} has fallen silent: the driver's seat is free")
        for text in self.suspensions.over(self.session):
            self.event(text)
        if not self.paused:
            self._tick(now_ns)
        due = (
            self._snapshot_ns is None or now_ns - self._snapshot_ns >= (SNAPSHOT_S - 0.5 * self.session.tick_s) * 1e9
        )
        if not due:
            return None
        self._snapshot_ns = now_ns
        return self._snapshot(now_ns, late)

    def _tick(self, now_ns: int) -> None:
        """Let one tick pass."""
        session = self.session
        intent, job = self._wanted(now_ns)
        self._levers = Levers() if intent is None else intent.levers
        held = session.gate_open
        done = session.step(intent, job)
        self._done = done
        if held and not session.gate_open and self.goals.job is not None and self.player is None:
            self.goals.cancel()
            self.event("the goal is given up: Enable is off")
        self._coasting.step(done.trace.valves, session.true_state[0])
        self._times = [*self._times, done.tick_ms][-TIMES:]
        facts = done.trace.job
        if facts is not None and self.player is None:
            said = self.goals.went(facts, [one.text for one in done.trace.reasons])
            if said:
                self.event(said)

    def _wanted(self, now_ns: int) -> tuple[Intent | None, Job | None]:
        """Return what is wanted in this tick, and the job."""
        session = self.session
        if self.player is not None and not self.stopped:
            facts: JobFacts | None = None if self._done is None else self._done.trace.job
            try:
                played = self.player.next(facts)
            except InputError as error:
                self.event(f"the scenario cannot go on: {error}")
                played = None
            if played is not None:
                return played
            self.stop_playing()
        anew, self._anew = self._anew or self.desk.driver != self._drove, False
        self._drove = self.desk.driver
        intent = self.desk.intent(now_ns, round(session.t_s * 1e9))
        if intent is None or self.stopped or anew:
            # nobody's hands, not hands let go: only their own letting go counts for the gate
            return None, None
        job = self.goals.job if intent.mode is DriveMode.AUTO else None
        if intent.mode is DriveMode.AUTO and job is None:
            # nothing to do: the hands stay on, the levers do nothing
            return Intent(intent.stamp, DriveMode.JOINT, Levers(), intent.enable), None
        return intent, job

    def _doing(self) -> str:
        if self.paused:
            return "paused"
        if self.player is not None:
            return "scenario"
        return "driving" if self.desk.driver else "idle"

    def _held(self, now_ns: int) -> tuple[Held, ...]:
        """Return why the machine is held back, what the desk has to say first."""
        own = []
        if self.stopped:
            own.append(Held("stopped", self.stopped, None, None, None, None, 0.0))
        if self.desk.slow(now_ns):
            trip_s = self.desk.round_trip_s(now_ns) or 0.0
            text = f"the driver's link takes {trip_s * 1e3:.0f} ms there and back"
            own.append(Held("link_slow", text, None, None, None, None, 0.0))
        if self._done is None:
            return tuple(own)
        reasons = (*self._done.trace.reasons, *self._done.travel.reasons)
        return (*own, *telling.held(reasons, self.names))

    def _snapshot(self, now_ns: int, late: int) -> Snapshot:
        session, desk, done = self.session, self.desk, self._done
        q, T = session.true_state
        n = session.machine.n
        trace = None if done is None else done.trace
        known = None if done is None else done.known
        if known is not None and known.posture is not None and known.pose is not None:
            q, T = known.posture.q, known.pose.T_site_machine
        health = None if known is None else known.health
        self._number += 1
        trip_s, age_s = desk.round_trip_s(now_ns), desk.intent_age_s(now_ns)
        times = sorted(self._times) or [0.0]
        valves = (0,) * n if trace is None else trace.valves
        still = telling.rounded(q * 0.0)
        snapshot = Snapshot(
            stamp=Stamp(session.machine_id, now_ns, SOURCE),
            number=self._number,
            t_s=round(session.t_s, 4),
            doing=self._doing(),
            step="" if self.player is None else self.player.words,
            driver=desk.driver,
            wanted_by=desk.wanted_by,
            round_trip_ms=None if trip_s is None else round(trip_s * 1e3, 1),
            intent_age_ms=None if age_s is None else round(age_s * 1e3, 1),
            intent=desk.sequence,
            stopped=self.stopped,
            enabled=session.gate_open and not self.paused,
            q=telling.rounded(q, 9),
            pose=telling.rows(T),
            stop_q=telling.rounded(self._coasting.rest(q)),
            desired=still if trace is None else telling.rounded(trace.desired),
            allowed=still if trace is None else telling.rounded(trace.allowed),
            valves=valves,
            levers=telling.rounded(self._levers.values, 4),  # type: ignore[arg-type]
            scale=1.0 if trace is None else round(trace.scale, 4),
            near=() if trace is None else telling.nearest(trace.clearances, self.names),
            held=self._held(now_ns),
            ranges=() if done is None else telling.lever_ranges(done),
            health="perfect" if health is None else str(health.state),
            health_reasons=() if health is None else tuple(one.text for one in health.reasons)[:6],
            guard=session.guard.name,
            settings=telling.guard_settings(session.guard),
            off_states=tuple(sorted(session.off_states & session.states)),
            let_off=tuple(sorted(session.let_off)),
            suspended=self.suspensions.now(session, self.names),
            preview=self.goals.preview_id,
            previewing=self.goals.working,
            running=self.goals.running,
            job="" if trace is None or trace.job is None else str(trace.job.state),
            tick_ms=(round(times[len(times) // 2], 3), round(times[-1], 3)),
            late_ticks=late,
            heard=desk.heard,
            answers=tuple(self.told.answers),
            events=tuple(self.told.events[-8:]),
        )
        desk.published(self._number, now_ns)
        return snapshot

    def setup(self, now_ns: int) -> Setup:
        """Return what does not change while the machine runs."""
        suspendable = [
            (name, self.names.name(name) or name, minutes) for name, minutes in self.suspensions.minutes.items()
        ]
        return telling.setup_of(
            self.session,
            Stamp(self.session.machine_id, now_ns, SOURCE),
            self._loaded.scenario.title,
            ", ".join(file.name for file in self._loaded.site_files),
            True,
            suspendable,
            self.settings.intent_age_s,
            self.settings.round_trip_s,
        )
