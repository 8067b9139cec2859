"""The words of programs: sentences to operators, signals between controllers, names of segments.

Sentences: processes and posts write them word for word, and the proof refuses any other. A sentence
is plain ASCII and has fields for its figures. Which ones stand where in a program, with which
figures, is claimed of each operation (`OperatorDialogue`), and follows from the problem for starts,
setups and error handlers (``proof/dialogue.py``). A program that has more to say
gets its sentence here, and its place there.

Files beside the programs: the wording which writer and proof both read. Lines of a box have 55
characters at most, lines of the panel 40.

Signals: how two controllers that share no more than them meet, and how each one knows that the
other one runs (:class:`Handshake`).

Segments: what a move belongs to, and the label by which people, plans and programs know it.
"""

from __future__ import annotations

import dataclasses
import functools
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal

from planner.geometry.arrays import FloatArray

Phase = Literal["", "in", "out"]
PHASES: Final[tuple[Phase, ...]] = ("in", "", "out")
"""The way in to what a segment works on, the work itself, the way out: in the order in which they come."""
WORKING_KINDS: Final = frozenset({"cut", "form", "mill", "trim"})
"""Kinds of segments in which a tool's own edge works the stock, and may touch it."""
ON_ENDING: Final = "on"
"""Ends the label of a segment without a phase whose name ends as if it had one."""
_ENDING: Final = re.compile(rf"(.+)_(in|out|{ON_ENDING})", re.DOTALL)
"""Label of a segment with a phase, or with the mark that it has none."""


@dataclasses.dataclass(frozen=True, slots=True)
class Segment:
    """Moves of one ``kind`` (approach, cut, link, ...), of one ``name`` within it, and of one ``phase``.

    The label ``str(segment)`` is ``kind``, ``kind/name`` or ``kind/name_phase``; a name that ends like a
    phase itself is told apart by ``_on``: ``cut/wall_in`` is the way in to ``wall``, ``cut/wall_in_on`` the
    cut of ``wall_in``. Kinds are in lower case. Raises ``ValueError`` for a phase of nothing that has a name,
    and for a kind with a ``/``.
    """

    kind: str
    name: str = ""
    phase: Phase = ""

    def __post_init__(self) -> None:
        if "/" in self.kind or self.phase not in PHASES or (self.phase and not self.name):
            raise ValueError(f"no segment: kind {self.kind!r}, name {self.name!r}, phase {self.phase!r}")
        object.__setattr__(self, "kind", self.kind.lower())

    @staticmethod
    def of(label: str) -> Segment:
        """The segment that a user means: ``kind`` or ``kind/name``, whatever the name ends with."""
        kind, _, name = label.partition("/")
        return Segment(kind, name)

    @staticmethod
    def read(label: str) -> Segment:
        """The segment that has this label: the inverse of ``str``."""
        return _read(label)

    def at(self, phase: Phase) -> Segment:
        """The segment of the same kind and name in another phase."""
        return Segment(self.kind, self.name, phase)

    @property
    def ways(self) -> tuple[Segment, ...]:
        """The way in, the work and the way out, of the same kind and name."""
        return tuple(self.at(phase) for phase in PHASES)

    @property
    def works(self) -> bool:
        """Whether an edge may touch the stock here."""
        return self.kind in WORKING_KINDS

    @property
    def folded(self) -> Segment:
        """The segment as programs can tell it: lower case, ASCII, single underscores for all other signs."""
        return _folded(self)

    @property
    def key(self) -> str:
        """The label of :attr:`folded`: two segments that programs cannot tell apart have one key."""
        return str(_folded(self))

    @property
    def word(self) -> str:
        """The label as one word, for the names of things in files: ``cut_wall``."""
        return str(self).replace("/", "_")

    def __str__(self) -> str:
        return _label(self)

    def __format__(self, spec: str) -> str:
        return format(_label(self), spec)


def fold(text: str) -> str:
    """Text in lower case, without accents, with one underscore for each run of what is neither letter nor
    digit, and none at the ends."""
    flat = unicodedata.normalize("NFKD", text)
    kept = "".join(c for c in flat if not unicodedata.combining(c))
    return re.sub(r"[^A-Za-z0-9]+", "_", kept).strip("_").lower()


def clash(segments: Iterable[Segment]) -> tuple[Segment, Segment] | None:
    """The first two of some segments that programs cannot tell apart, or that are the same; else None."""
    known: dict[str, Segment] = {}
    for segment in segments:
        if segment.key in known:
            return known[segment.key], segment
        known[segment.key] = segment
    return None


@functools.lru_cache(maxsize=65536)
def _label(segment: Segment) -> str:
    if not segment.name:
        return segment.kind
    name, phase = segment.name, segment.phase
    alike = _ENDING.fullmatch(name) or _ENDING.fullmatch(fold(name))
    return f"{segment.kind}/{name}" + (f"_{phase or ON_ENDING}" if phase or alike else "")


@functools.lru_cache(maxsize=65536)
def _read(label: str) -> Segment:
    kind, _, text = label.partition("/")
    found = _ENDING.fullmatch(text)
    if found is None:
        return Segment(kind, text)
    return Segment(kind, found[1], "in" if found[2] == "in" else "out" if found[2] == "out" else "")


@functools.lru_cache(maxsize=65536)
def _folded(segment: Segment) -> Segment:
    name = fold(segment.name)
    return Segment(fold(segment.kind), name, segment.phase if name else "")


SPELT: Final = str.maketrans(
    {"ß": "ss", "æ": "ae", "Æ": "Ae", "œ": "oe", "Œ": "Oe", "ø": "o", "Ø": "O", "ł": "l", "Ł": "L", "đ": "d"}
    | {"–": "-", "—": "-", "’": "'", "‘": "'", "“": '"', "”": '"', "„": '"', "°": " deg", "×": "x"}
)
"""Letters and signs that do not come apart into ASCII and accents, as panels get them."""


@dataclasses.dataclass(frozen=True)
class Sentence:
    """Words with named fields as ``str.format`` takes them; the format of a field is how its figure is
    rounded."""

    words: str

    def filled(self, **figures: float | str) -> str:
        """The sentence with its figures."""
        return self.words.format(**figures)


HEADER: Final = "Tandem"
"""Above each box that asks something."""
PLAIN: Final = Sentence("{text}")
"""A sentence of the user's own, in setups."""

# ---- before anything moves ----

NO_WIRE: Final = Sentence(
    "Is there NO wire between the arms? Each arm now goes home alone, then to its first position, alone or "
    "at once with the other one. Take off what joins them, see that their ways are clear, then press OK."
)
"""Where a wire will join the arms."""
READY: Final = Sentence("Is the stock in place and the way of each arm clear? Press OK to start.")
CLEAR: Final = Sentence(
    "Is the way of each arm to its home clear, and nobody in the cell? Press OK to start."
)
"""Where the first setup is told and confirmed afterwards."""
KRL_READY: Final = Sentence("Is the stock in place and the way of the arm clear?")
KRL_CLEAR: Final = Sentence("Is the way of the arm to its home clear, and nobody in the cell?")

# ---- tracks and turntables ----

KEEP_OFF: Final = Sentence(
    "Keep off the track {unit}: it takes arm {arm}, folded at its home, to {value} mm once this is confirmed."
)
"""Told before a track goes to a station, of which nothing else tells."""
KEEP_OFF_RIDING: Final = Sentence(
    "Keep off the track {unit}: it takes arm {arm}, folded at its home, to {value} mm once this is "
    "confirmed, and goes along while the arm works."
)
"""The same of one that goes along from there."""
KEEP_OFF_GANTRY: Final = Sentence(
    "Keep off the gantry {unit}: once this is confirmed it takes arm {arm}, folded at its home, one "
    "axis after "
    "the other, to where they stand: {values}."
)
"""Told before the axes of a gantry go to a station."""
KEEP_OFF_TABLE: Final = Sentence(
    "Keep off the turntable {unit} and what stands on it: it turns to {value} deg once this is confirmed."
)
"""Told before a turntable goes to a station."""
KEEP_OFF_POSITIONER: Final = Sentence(
    "Keep off the positioner {unit} and what stands on it: once this is confirmed it turns to {turn} deg, "
    "then tilts to {tilt} deg."
)
"""Told before a positioner goes to a station."""
CLOSED: Final = "All work done, nobody in the cell?"
"""Asked before tracks and turntables go home behind the last operation."""
KRL_AXIS_AWAY: Final = Sentence("{unit} is %1 {sign} off home, {home}: jog it there, reset")
"""Of a KUKA robot whose track or turntable is not at home before its first move."""

# ---- two controllers ----

EARLIER: Final = Sentence(
    "Does no program of an earlier run go on at the controller of arm {other}? Press OK."
)
KRL_EARLIER: Final = Sentence("Does no program of an earlier run go on at the controller of arm {other}?")
UR_EARLIER: Final = Sentence("Is the program of arm {other} stopped (not paused, no question open)?")
"""What the UR program that leads asks first."""
UR_CALLED: Final = Sentence("Does the panel of arm {other} say to start this program now?")
"""What the one that follows asks first."""
PARTNER_READY: Final = Sentence(
    "Does the panel of arm {other} say that it is ready to meet arm {arm}? {start}"
)
"""Asked by the program that leads, together with its question before the start."""
READY_TO_MEET: Final = Sentence("Ready to meet arm {other}.")
START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Start here."
)
"""Told by the program that leads, right before it stops."""
UR_START_PARTNER: Final = Sentence(
    "Start the program of arm {other} now. When its panel says that it is ready, press Continue here."
)
"""The same of a UR controller, whose next popup asks whether it is ready."""
UNANSWERED: Final = Sentence(
    "Arm {other} did not answer in time, or its running wire is not as it should be."
)

PARTNER_LOST: Final = Sentence("The program of arm {other} does not run any more, so this one ends.")
"""On the panel of a UR controller that has seen the other one stop."""
STAYS_ON: Final = Sentence(
    "{signal} is on before the program: set it to low when not running in Installation, I/O."
)
"""On the panel of a UR controller whose running wire, or the output of a torch, stays high when a program
stops."""

WAITING: Final = Sentence("Waiting for arm {arm}.")
TOGETHER: Final = Sentence("Moves with arm {arm} and waits for it where they meet.")
"""On the panel of a KUKA controller while its program waits for the other arm, and moves together with it."""

NO_ARC: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Begin it anew.")
"""On the panel of a UR controller whose program waited in vain for a torch to burn."""
ARC_LOST: Final = Sentence(
    "{signal} is off, no {ok_signal}, or the torch stood: the program ends. Move it out by hand."
)
"""On the panel of a UR controller whose torch does not burn any more, or stands."""
TORCH_STOOD: Final = Sentence("{signal} is off, or the torch stood: the program ends. Move it out by hand.")
"""The same of a torch that has no input."""
NO_INPUT: Final = Sentence("No {signal} in {seconds:g} s: the program ends. Reset it.")
"""On the panel of a KUKA controller whose program waited for an input of its process in vain."""

# ---- where a robot stands ----

FOOT: Final = Sentence("Arm {arm}: $ROBROOT is off zero by %1 mm, %2 deg")
"""Of a KUKA robot; its controller puts the figures in."""
FOOT_RIDES: Final = Sentence("Arm {arm}: $ROBROOT_C is off track by %1 mm, %2 deg")
"""The same of one on a track."""

OTHER_ARM: Final = Sentence("Arm {arm}: this controller moves another arm than the planned {model}.")
"""Of a UR robot, whose controller has its flange elsewhere at home than the plan."""

# ---- error handlers ----

FAILED: Final = Sentence("Tandem: error in {procedure}, number")
"""In front of the error's number."""
JOINED: Final = Sentence("The arms may be joined: move neither alone.")
ALONE: Final = Sentence("Check the arm before it moves.")

# ---- a bent wire ----

WIRE: Final = Sentence("Wire: {material} {size}")
"""Which wire to mount; ``size`` as `SectionFile.size` has it."""
MOUNT: Final = Sentence("Mount wire: {cold_mm:.1f} mm cold between clamps")
CLAMPS: Final = Sentence("Clamps {apart_mm:.1f} mm apart, wire at {start_deg:.1f} and {end_deg:.1f} deg")
CLAMPED: Final = Sentence("Wire clamped, slide free, block fixed, nobody in the cell?")
LOCKED: Final = Sentence("Slide taken up to {hot_mm:.1f} mm hot and locked?")
TAKEN_OFF: Final = Sentence("Wire cold and taken off?")

# ---- a bow ----

BOW_POWER: Final = Sentence("Wire {diameter_mm:g} mm{material}, {power_w:g} W")
"""``material``: empty, or with a space in front."""
BOW_SLOT: Final = Sentence("Wire {diameter_mm:g} mm{material}, heat for a slot of {kerf_mm:g} mm")
TAUT: Final = Sentence("Wire taut, block fixed, nobody in the cell?")
SPACERS: Final = Sentence("Put spacers of {kerf_mm:.1f} mm into the slot")
SPACED: Final = Sentence("Spacers in the slot, nobody in the cell?")
COLD: Final = Sentence("Wire cold, hands may come near?")

# ---- a cutter ----

BLOCK: Final = Sentence(
    "Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min"
)
BLOCK_OF_FILE: Final = Sentence("Block {x_mm:g} x {y_mm:g} x {z_mm:g} mm; {kind} mill of {diameter_mm:g} mm")
"""Where all cuts are files: their questions name the speeds."""
BLOCK_READY: Final = Sentence("Block and cutter clamped, nobody in the cell?")
GO_ON: Final = Sentence("Go on: {asked}?")
"""Between passes of a file, ``asked`` being one or more of the next three with commas between."""
FILE_LINE: Final = Sentence("line {line} of the file")
SPEED: Final = Sentence("spindle at {rpm:.0f} 1/min")
SPEED_BACK: Final = Sentence("spindle at {rpm:.0f} 1/min counterclockwise (M4)")
STANDS: Final = Sentence("Spindle stands, take the part out?")

# ---- a sheet ----

SHEET: Final = Sentence("Sheet {x_mm:g} x {y_mm:g} x {z_mm:g} mm, {metal}")
RIM: Final = Sentence("Blank holder {high_mm:.2f} mm above its end, flat sheet on the die?")
LEVEL: Final = Sentence("Level {number:.0f} of {name} alone: the sheet as the levels before it left it?")
FIRST_PASS: Final = "the first pass"
"""Name of a level's pass that nobody names."""
SHEET_READY: Final = Sentence("Sheet clamped and greased, nobody in the cell?")
STAGE_READY: Final = Sentence("Sheet as it was left, greased, no loose piece, nobody in the cell?")
FORMED: Final = Sentence("Tools off the sheet, take the part out?")
STAYS: Final = Sentence("Tools off the sheet, which stays clamped?")


# ---- a torch ----

TORCH: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {cuts_by} torch, kerf {kerf_mm:g} mm, {off_mm:g} mm off the sheet"
)
TORCH_STOPPED: Final = Sentence(
    "A stop while the torch burns ends this program: nothing lights it again there"
)
TORCH_READY: Final = Sentence(
    "Sheet clamped, none of these slots in it yet, return lead on, fumes drawn off, nothing that burns "
    "beside or below the sheet, eyes shielded, nobody in the cell?"
)
TORCH_COLD: Final = Sentence(
    "Torch off and edges cold? What is cut out lies hot below the sheet. "
    "Take dross off before it is formed on."
)
TRIM_MILL: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; {kind} mill of {diameter_mm:g} mm, {rpm:g} 1/min, "
    "{below_mm:g} mm through the sheet"
)
TRIM_MILL_READY: Final = Sentence(
    "Sheet and cutter clamped, none of these slots in it yet, nothing below the sheet where they are, "
    "nobody in the cell?"
)
TRIM_MILL_STANDS: Final = Sentence(
    "Spindle stands? Take loose pieces out, and burrs off before it is formed on."
)
TRIM_KNIFE: Final = Sentence(
    "Sheet of {t_mm:g} mm, {metal}; knife with a blade of {wide_mm:g} x {thick_mm:g} mm, {below_mm:g} mm "
    "through the sheet"
)
TRIM_KNIFE_READY: Final = Sentence(
    "Sheet and blade clamped, its edge ahead, none of these cuts in it yet, nothing below the sheet where "
    "they are, nobody in the cell?"
)
TRIM_KNIFE_DONE: Final = Sentence("Knife still? Take loose pieces out; blade and edges are sharp.")


Figure = float | str | None
"""A figure of a sentence; None: the proof takes it from the motion."""


@dataclasses.dataclass(frozen=True)
class DialogueStep:
    """One step: a sentence ``told`` on the panel, one ``asked`` that the operator confirms, ``signal``
    switched ``on`` or ``off``, a ``wait`` of ``seconds``, or one until the ``input`` ``signal`` is 1, for
    ``seconds`` at most. ``figures`` of the sentence by name."""

    kind: Literal["told", "asked", "on", "off", "wait", "input"]
    sentence: Sentence | None = None
    figures: Mapping[str, Figure] = dataclasses.field(default_factory=dict)
    signal: str = ""
    seconds: float = 0.0


def message_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """The operator can read a sentence."""
    return DialogueStep("told", sentence, figures)


def question_step(sentence: Sentence, **figures: Figure) -> DialogueStep:
    """The operator reads a sentence and confirms it."""
    return DialogueStep("asked", sentence, figures)


def power_on_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """A signal goes on, and ``seconds`` [s] pass."""
    return DialogueStep("on", signal=signal), DialogueStep("wait", seconds=seconds)


def power_off_steps(signal: str, seconds: float) -> tuple[DialogueStep, DialogueStep]:
    """A signal goes off, and ``seconds`` [s] pass."""
    return DialogueStep("off", signal=signal), DialogueStep("wait", seconds=seconds)


@dataclasses.dataclass(frozen=True)
class DialogueStop:
    """Steps at a stop within the work: ``before`` the first move of ``segment``, ``behind`` its last one, or
    ``in`` it and its way in. ``at`` (3,) [m, stock frame]: where the tool is then, within ``near`` [m].
    ``repeats``: any number of times, each time whole; ``optional``: not at all, or whole."""

    segment: Segment
    where: Literal["before", "behind", "in"]
    steps: tuple[DialogueStep, ...]
    at: FloatArray | None = None
    near: float = 0.0
    repeats: bool = False
    optional: bool = False


@dataclasses.dataclass(frozen=True)
class OperatorDialogue:
    """All that the programs say, ask, switch and wait for in an operation of ``arms``, in this order and
    nothing else: ``first`` when all arms stand at their first targets, ``stops`` on the way, ``last`` when
    they stand at their last ones. The first of the arms, in the cell's order, speaks, and meanwhile all arms
    stand still. ``joined``: the arms are joined then, which the operator is asked about before the start."""

    arms: tuple[str, ...]
    first: tuple[DialogueStep, ...] = ()
    last: tuple[DialogueStep, ...] = ()
    stops: tuple[DialogueStop, ...] = ()
    joined: bool = False


BUTTONS: Final = ("Free", "On", "Stop")
"""Answers to :func:`again`: nothing stands in the way of what follows; power is on again; neither."""

OFF_BY_MM: Final = "is off by [mm]"
OFF_BY_DEGREES: Final = "and turned by [degrees]"
OFF_HOME: Final = "is off its home by"
"""What a track or turntable is; its figure, in mm or degrees, follows."""
NOT_AS_PLANNED: Final = "is not as it was planned."
NOTHING_MOVES: Final = ("Nothing moves. Put it right,", "then PP to main in all tasks.")
REFUSED: Final = (
    "Not started: the power was on at the",
    "stop. Free the wire or tool, then",
    "PP to main in all tasks.",
)


def again(signal: str) -> tuple[str, ...]:
    """The question at a start behind a stop at which the power ``signal`` was on."""
    return (
        f"{signal} was on at the stop.",
        "Free: block and part are out of all that follows.",
        f"On: {signal} is 1 again by hand,",
        "and the wire is hot, or the tool at full speed.",
        "Stop: neither. Free it, then PP to main in all tasks.",
    )


BEGIN_BUTTONS: Final = ("Begin", "Stop")
"""Answers to :func:`burned`: from main, with a sheet without these slots; or nothing."""
ENDED: Final = (
    "Not started: a torch burned at the stop",
    "or the controller was off. Move it out",
    "by hand, look at the sheet, then PP to",
    "main in all tasks, and Start.",
)
"""Told where a program would go on behind a stop at which a torch burned."""


def burned(signal: str) -> tuple[str, ...]:
    """The question at a start anew behind a stop at which the torch of ``signal`` burned."""
    return (
        f"{signal} burned at the stop,",
        "or the controller was off since.",
        "Begin: PP is at main, the torch was moved out by hand,",
        "and the sheet has no slot of this program yet.",
        "Stop: else. Then plan anew what is left to cut.",
    )


def base_of(arm: str) -> str:
    """What is compared: the base frame of an arm."""
    return f"Base of arm {arm}"


def frame_of(name: str) -> str:
    """What is compared: the frame of a tool."""
    return f"Frame of {name}"


def user_frame_of(name: str) -> str:
    """What is compared: the user frame of a work object."""
    return f"User frame of {name}"


def object_frame_of(name: str) -> str:
    """What is compared: the object frame of a work object."""
    return f"Object frame of {name}"


def axis_of(unit: str) -> str:
    """What is compared: where a track or turntable stands."""
    return f"Axis {unit}"


def kind_of(name: str) -> str:
    """What is compared: who holds a tool or a work object."""
    return f"Holder of {name}"


HandshakeKind = Literal["four_phase", "toggle"]


@dataclasses.dataclass(frozen=True)
class PartnerSignals:
    """Names that one controller has for its output to the other one and for its input from there.

    ``running``: the output that the controller itself holds at 1 while its program runs with the motors on;
    ``partner_running``: the input that the other one's drives, which no program switches either;
    ``move_enable``: of a KUKA controller, the output that is looped to its input for $MOVE_ENABLE.
    """

    output: str = "doPartner"
    input: str = "diPartner"
    running: str = "doRunning"
    partner_running: str = "diPartnerRunning"
    move_enable: str = "doMoveEnable"

    @property
    def lost(self) -> str:
        """Of an ABB controller, what ``partner_running`` is not: its rise stops the program."""
        return f"{self.partner_running}_lost"


@dataclasses.dataclass(frozen=True)
class SignalWire:
    """A wire between controllers: the output ``output`` of the arm ``source`` drives the input ``input`` of
    the arm ``sink``."""

    source: str
    output: str
    sink: str
    input: str


@dataclasses.dataclass(frozen=True)
class Handshake:
    """The handshake of two controllers.

    ``kind``: two signal changes of each side at every meeting, or one. ``every``: they meet at every so many
    moves. ``signals`` {arm: names}, the defaults for an arm that is not named; ``wires``: what drives what;
    ``running``: the wires that say that a controller runs.
    ``timeout`` [s]: how long an arm waits for the other one at a step of joint work; ``patience`` [s]: how
    long while the other arm moves alone or asks the operator.
    """

    kind: HandshakeKind = "four_phase"
    every: int = 1
    signals: Mapping[str, PartnerSignals] = dataclasses.field(default_factory=dict)
    wires: tuple[SignalWire, ...] = ()
    running: tuple[SignalWire, ...] = ()
    timeout: float = 30.0
    patience: float = 3600.0

    def of(self, arm: str) -> PartnerSignals:
        """The signals of an arm's controller."""
        return self.signals.get(arm, PartnerSignals())

    def wired(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """The wires between two arms' controllers by which they meet; unless stated, outputs drive the other
        one's inputs."""
        if self.wires or len(arms) != 2:
            return self.wires
        return tuple(
            SignalWire(a, self.of(a).output, b, self.of(b).input) for a, b in (tuple(arms), tuple(arms)[::-1])
        )

    def wired_running(self, arms: Sequence[str]) -> tuple[SignalWire, ...]:
        """The wires by which two arms' controllers know that the other one runs; as :meth:`wired`."""
        if self.running or len(arms) != 2:
            return self.running
        return tuple(
            SignalWire(a, self.of(a).running, b, self.of(b).partner_running)
            for a, b in (tuple(arms), tuple(arms)[::-1])
        )
