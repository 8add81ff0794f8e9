"""What a session's machine believes of itself: posture, pose, health and the tracks it stands on, out of bytes."""

from collections.abc import Sequence

from workgauge.rehearse.navigation import Known, armed
from workgauge.rehearse.senses import Senses
from workgauge.rehearse.setting import Setting
from workgauge.values.ports import Chunk


class Belief:
    """Goes on from tick to tick with what arrives.

    Args:
        setting: what the session is about. senses: what its machine measures with.

    Attributes:
        navigator: from bytes to what is known. source: of the bytes, None for the plant's own.
        known: newest. tracks: what the machine is believed to stand on.
    """

    def __init__(self, setting: Setting, senses: Senses) -> None:
        self._setting = setting
        self.navigator, self.source = senses.navigator, senses.source
        self.known, self.tracks = Known(), setting.on_tracks

    def take(self, perfect: Sequence[Chunk], now_ns: int, *, checked: bool) -> Known:
        """Return what is known now.

        Args:
            perfect: what the plant itself sends, in the absence of a source. checked: see `navigation.armed`.
        """
        chunks = perfect if self.source is None else self.source.read(now_ns)
        found = self.navigator.take(chunks, now_ns, self._setting.follower.track(self.tracks.own))
        self.known = armed(found, self._setting.machine, checked)
        if self.known.pose is not None:
            self.tracks = self._setting.standing_on(self.tracks, self.known.pose.T_site_machine)
        return self.known

    @property
    def ready(self) -> bool:
        """Whether posture and position are known and may be used."""
        known = self.known
        usable = known.health is None or known.health.state.usable
        return self.source is None or (known.posture is not None and known.pose is not None and usable)
