"""The door of this package: a plan and its problem in, program files out; what no program can say.

Each arm gets the language of its controller. Beside the programs go files for the controllers: for
power that they switch, and for wires by which two of them know of each other. Refused before
anything is planned: cells whose controllers cannot do the job together, signals without numbers,
and names of segments that programs cannot carry.
"""

from __future__ import annotations

import dataclasses
import itertools
import re
from collections.abc import Mapping, Sequence
from typing import Final

from planner.claims.claim import Claim
from planner.claims.segments import Segment
from planner.geometry.arrays import FloatArray
from planner.issues import Issue, TandemError
from planner.languages.krl.writer import controller_files as krl_files
from planner.languages.krl.writer import program as krl_program
from planner.languages.krl.writer import spline_blocks
from planner.languages.rapid.writer import controller_files as rapid_files
from planner.languages.rapid.writer import program as rapid_program
from planner.languages.rapid.writer.syntax import procedure
from planner.languages.trajectories.writer import program as trajectories
from planner.languages.trajectories.writer.refusals import trajectory_refusals
from planner.languages.urscript.writer import program as ur_program
from planner.languages.writing import handshake
from planner.languages.writing.handshake import handshake_refusals
from planner.languages.writing.layout import LINE_END, Do, Job, TaskProgram, no_input
from planner.languages.writing.names import alike
from planner.languages.writing.steps import build
from planner.plans import Plan
from planner.problem import Arm, Problem, lights_torch, torch_signals
from planner.targets import Targets

CONTROLLER_FOLDER: Final = "controller"
"""Folder of files for a controller's configuration, beside the programs."""


def controller_texts(job: Job, plan: Plan, problem: Problem) -> dict[str, str]:
    """Files by relative name, such as ``controller/T_ROB1/EIO.cfg``, in a folder for each controller: by its
    first task, or by its arm where each arm has one. One controller has none where nothing is powered; two
    have them always, for the wires by which each knows that the other one runs."""
    controller = problem.cell.controller
    actions = [action for operation in plan.operations for action in operation.targets.actions]
    powered = {action.signal for action in actions if action.powers}
    alone = controller.sync == "handshake"
    arms = [task.arm.name for task in job.tasks]
    wires = controller.handshake.wired_running(arms) if job.handshake is not None else ()
    out: dict[str, str] = {}
    torches = torch_signals(problem.operations)
    lit = {
        task.arm.name: sorted(powered & torches & set(job.switched(task)), key=str.lower)
        for task in job.tasks
    }
    for task in job.tasks:
        signals = sorted((s for s in job.switched(task) if s in powered), key=str.lower)
        if not signals and not wires:
            continue
        name, burning = task.arm.name, lit[task.arm.name]
        if task.robot.family in ("UR", "ROS"):
            continue  # its installation is set at the panel, or is the runner's
        if task.robot.family == "KUKA":
            made, folder = krl_files.files(controller, name, signals, wires, burning), name
        elif alone:
            others = _others(job, [task], signals)
            made = rapid_files.files(controller, [task.task], signals, others, [name], wires, burning)
            folder = name
        elif task.number == 1:
            tasks = [other.task for other in job.tasks]
            others, own = _others(job, job.tasks, signals), [other.arm.name for other in job.tasks]
            made = rapid_files.files(controller, tasks, signals, others, own, (), burning)
            folder = task.task
        else:
            continue  # files of the first task are for all of one controller
        if wires and any(lit.values()):
            made["README.txt"] += handshake.burned_anew(lit, name)
        out |= {
            f"{CONTROLLER_FOLDER}/{folder}/{name}": text.replace("\n", LINE_END)
            for name, text in made.items()
        }
    return out


def _others(
    job: Job, tasks: Sequence[TaskProgram], signals: Sequence[str]
) -> dict[str, rapid_files.SignalType]:
    """Signals besides the powering ``signals`` that the programs of one ABB controller name, with types:
    inputs that they wait for, outputs that ask for a step, and the lines between two controllers."""
    steps = [step for task in tasks for operation in task.operations for step in operation.steps]
    inputs = {step.action.signal for step in steps if isinstance(step, Do) and step.action.kind == "input"}
    outputs = {signal for task in tasks for signal in job.switched(task)} - set(signals)
    if job.handshake is not None:
        lines = [job.handshake.of(task.arm.name) for task in tasks]
        inputs |= {own.input for own in lines}
        outputs |= {own.output for own in lines}
    kinds: dict[str, rapid_files.SignalType] = dict.fromkeys(sorted(outputs, key=str.lower), "DO")
    return kinds | dict.fromkeys(sorted(inputs, key=str.lower), "DI")


_ONE_CONTROLLER_HINT: Final = (
    "one controller for both arms (sync: multimove) is ABB's; arms of KUKA and UR have one each"
)
"""Said where arms that are not ABB's shall have one controller."""


def used(problem: Problem, made: Sequence[Targets]) -> list[Arm]:
    """The arms that take part in any operation, in the cell's order."""
    names = {arm for targets in made for arm in targets.arms}
    return [arm for arm in problem.cell.arms if arm.name in names]


LANGUAGES: Final = {"ABB": "RAPID", "KUKA": "KRL", "UR": "URScript", "ROS": "trajectories of ROS 2"}
"""Languages of programs by the families of controllers that read them."""
_OWN: Final = ("ABB", "KUKA", "UR")
"""Families that have a language of their own."""
_BY_NUMBER: Final = ("KUKA", "UR")
"""Families whose controllers know signals by number alone."""


def _unspoken(arms: Sequence[Arm]) -> list[Issue]:
    """Arms for whose controllers no programs are written (``post.language``)."""
    hint = "where a computer with ROS 2 moves it, set controller: {language: ros}; else plan with an arm of "
    hint += f"{' or '.join(_OWN)}; check tells of its reach all the same"
    allowed = ", ".join(f"{family} ({LANGUAGES[family]})" for family in _OWN)
    out = []
    for arm in arms:
        if arm.data.family in LANGUAGES:
            continue
        what = f"is of the family {arm.data.family}, whose language is not written yet"
        if arm.data.axes > 6:
            what = "has seven axes, and no controller's own language that is written here states seven joints"
        what = f"arm {arm.name} ({arm.robot}) {what}; allowed are {allowed}"
        out.append(Issue("post.language", what, arm=arm.name, hint=hint))
    return out


def speaks_krl(arm: Arm) -> bool:
    """Whether an arm's controller is KUKA's."""
    return arm.data.family == "KUKA"


def speaks_urscript(arm: Arm) -> bool:
    """Whether an arm's controller is UR's."""
    return arm.data.family == "UR"


def speaks_trajectories(arm: Arm) -> bool:
    """Whether an arm is driven by joint trajectories of ROS 2."""
    return arm.data.family == "ROS"


def controller_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why the controllers of this cell cannot do this job, however it is planned: arms of KUKA or UR on a
    controller for both (``post.controller``), arms of UR that are none (``post.ur_arm``) or hold the block
    (``post.load``), signals without a number where programs need it (``post.signal``), families without a
    language (``post.language``)."""
    arms = used(problem, made)
    if unspoken := _unspoken(arms):
        return tuple(unspoken)
    if any(map(speaks_trajectories, arms)):
        return tuple(trajectory_refusals(problem, arms))
    together = len(arms) > 1
    abb = all(arm.data.family == "ABB" for arm in arms)
    if together and not abb and problem.cell.controller.sync != "handshake":
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        hint = "set controller: {sync: handshake} and wire two outputs each way, or take ABB robots for both"
        return (Issue("post.controller", f"{names} cannot move together: {_ONE_CONTROLLER_HINT}", hint=hint),)
    if together and any(map(speaks_urscript, arms)):
        names = " and ".join(f"{arm.name} ({arm.robot})" for arm in arms)
        what = f"{names} cannot work in one job: "
        if not all(map(speaks_urscript, arms)):
            what += (
                "a program of UR begins anew behind each stop, and nothing keeps one of another controller "
                "from going on in the middle, where it would meet the one that begins"
            )
            hint = "take two arms of UR, two of ABB or KUKA, or plan with one arm alone"
            return (Issue("post.controller", what, hint=hint),)
        if problem.cell.controller.handshake.kind != "four_phase":
            what += (
                "by a toggle a program of UR cannot tell at every second meeting whether the other one was "
                "started anew while it asked somebody"
            )
            hint = "controller: {handshake: {kind: four_phase}}"
            return (Issue("post.controller", what, hint=hint),)
    issues: list[Issue] = []
    for arm in arms:
        if arm.data.family not in _BY_NUMBER:
            continue
        torches = [o for o in problem.operations if lights_torch(o) and arm.name in o.arms]
        if speaks_urscript(arm) and torches and together:
            issues.append(_no_torch(arm))
        elif speaks_urscript(arm):
            known = {getattr(operation, "ok_signal", None) for operation in torches}
            inputs = (a for t in made for a in t.actions if a.kind == "input" and t.arms[0] == arm.name)
            inputs = (action for action in inputs if action.signal not in known)
            issues += [
                issue for action in itertools.islice(inputs, 1) for issue in no_input(action, arm.name).issues
            ]
        wanted = _signals(problem, made, arm, together)
        missing = [signal for signal in wanted if problem.cell.controller.number(arm.name, signal) is None]
        if missing:
            listed, language = ", ".join(missing), LANGUAGES[arm.data.family]
            got = f"arm {arm.name} ({arm.robot}) is to use {listed}, which {language} knows by number only"
            hint = f"state the numbers: controller: {{io: {{{arm.name}: {{{missing[0]}: 1}}}}}}, as they are"
            issues.append(
                Issue("post.signal", got, field=f"controller.io.{arm.name}", arm=arm.name, hint=hint)
            )
    issues += _exchanged(problem, arms)
    holders = dict.fromkeys(setup.stock.held_by for setup in problem.setups)
    issues += [ur_program.no_load(arm.name) for arm in filter(speaks_urscript, arms) if arm.name in holders]
    for arm in filter(speaks_urscript, arms):
        try:
            ur_program.controller_base(arm)
        except TandemError as error:
            issues += error.issues
    return tuple(issues)


def _no_torch(arm: Arm) -> Issue:
    """Why an arm of UR cuts with no torch beside another one."""
    what = f"arm {arm.name} ({arm.robot}) is to cut with a torch beside another arm of UR: while one of both "
    what += "programs waits, nothing is known of how long the torch would burn at one place"
    hint = "cut in a job of its own, with one arm, or by a mill (by: {kind: mill})"
    return Issue("post.controller", what, arm=arm.name, hint=hint)


def _signals(problem: Problem, made: Sequence[Targets], arm: Arm, together: bool) -> list[str]:
    """Signals that an arm's program and its submit interpreter use: of the actions that it leads, and of its
    handshake."""
    order = [item.name for item in problem.cell.arms]
    out = [
        action.signal
        for targets in made
        if min(targets.arms, key=order.index) == arm.name
        for action in targets.actions
        if action.kind in ("on", "off", "input")
    ]
    if together:
        own = problem.cell.controller.handshake.of(arm.name)
        out += [own.output, own.input, own.running, own.partner_running]
        out += [own.move_enable] if speaks_krl(arm) else []
    return list(dict.fromkeys(out))


def _exchanged(problem: Problem, arms: Sequence[Arm]) -> list[Issue]:
    """Two controllers of UR on which each other's programs would run (``post.signal``): nothing but numbers
    tells two arms of one model apart, so what says that one runs must be nothing at the other one."""
    controller = problem.cell.controller
    if len(arms) != 2 or not all(map(speaks_urscript, arms)):
        return []
    out = []
    for arm, other in (arms, arms[::-1]):
        running = controller.handshake.of(arm.name).running
        number, theirs = controller.number(arm.name, running), controller.handshake.of(other.name)
        inputs = {theirs.input.lower(), theirs.partner_running.lower()}
        taken = [
            signal
            for signal, value in controller.io.get(other.name, {}).items()
            if value == number and signal.lower() not in inputs
        ]
        if number is not None and taken:
            got = f"{running} of arm {arm.name} is output {number}, as {taken[0]} of arm {other.name} is"
            what = f"{got}; programs copied to each other's controller would run there unnoticed"
            hint = f"take an output for {running} of arm {arm.name} that arm {other.name} does not use"
            field = f"controller.io.{arm.name}.{running}"
            out.append(Issue("post.signal", what, field=field, arm=arm.name, hint=hint))
    return out


_OWN_NAMES: Final = re.compile(
    r"main|operation_\d+|handshake\w*|block_\d+_\w+|meet_\d+|j_\w+|t_\w+|w_\w+|z_turn_\d+|z\d+[mu]m|v_entry|"
    r"load_block\w*|check_(cell|pose|true|stop)|base_frame|problem_digest|all_tasks"
)
"""Names of other things in RAPID programs."""


def name_refusals(problem: Problem, made: Sequence[Targets]) -> tuple[Issue, ...]:
    """Segments that programs cannot tell apart, that two operations of one setup have in common though
    something is claimed of them, and names that RAPID does not take (all ``post.name``). ``made``: the
    targets of each operation."""
    rapid = not all(
        speaks_krl(arm) or speaks_urscript(arm) or speaks_trajectories(arm) for arm in used(problem, made)
    )
    out: list[Issue] = []
    known: dict[str, Segment] = {}
    for number, targets in enumerate(made):
        field = f"operations.{number}"
        for segment in dict.fromkeys(targets.segment):
            other = known.setdefault(segment.key, segment)
            if other != segment:
                out.append(dataclasses.replace(alike(other, segment), field=field))
            elif rapid:
                out += _refused(segment, field)
    return (*out, *_shared(problem, made))


def _refused(segment: Segment, field: str) -> tuple[Issue, ...]:
    try:
        name = procedure(segment)
    except TandemError as error:
        return tuple(dataclasses.replace(issue, field=field) for issue in error.issues)
    if _OWN_NAMES.fullmatch(name.lower()) is None:
        return ()
    what = f"segment {str(segment)!r} would be called {name}, as other things in RAPID programs are"
    return (Issue("post.name", what, field=field, hint="give it another kind or name"),)


def _shared(problem: Problem, made: Sequence[Targets]) -> list[Issue]:
    """Segments of two operations of one setup, which the proof would hold against the claims of both."""
    out: list[Issue] = []
    setups = [problem.setup_of(number).number for number in range(len(made))]
    for number, targets in enumerate(made):
        for before in range(number):
            if setups[before] != setups[number]:
                continue
            keys = {segment.key: segment for segment in dict.fromkeys(targets.segment)}
            claimed = _claimed(targets.claims) | _claimed(made[before].claims)
            both = [key for key in dict.fromkeys(s.key for s in made[before].segment) if key in keys]
            own = [keys[key] for key in both if key in claimed or keys[key].works]  # G-code is claimed whole
            if own:
                shown = str(own[0].at(""))
                names = [problem.operations[index].name for index in (before, number)]
                what = f"operations {names[0]!r} and {names[1]!r} both have the segment {shown!r}"
                hint = "do it once, give one of them another name, or give the second a setup of its own"
                out.append(Issue("post.name", what, field=f"operations.{number}", hint=hint))
    return out


def _claimed(claims: Sequence[Claim]) -> set[str]:
    """Keys of the segments of which something is claimed."""
    out: set[str] = set()
    for claim in claims:
        own = getattr(claim, "segments", None) or (getattr(claim, "segment", None),)
        out |= {segment.key for segment in own if isinstance(segment, Segment)}
    return out


def programs(plan: Plan, problem: Problem, margins: Mapping[str, str] | None = None) -> dict[str, str]:
    """Texts of the program files by relative name, such as ``T_ROB1/TandemMain_1.mod``; of two controllers,
    and of KUKA's and UR's arms, in folders by arm, such as ``left/TandemMain_1.mod``, ``left/ruled_wall.src``
    or ``left/ruled_wall.script``; of arms that trajectories drive one file, ``ruled_wall.trajectory.jsonl``.

    Each arm gets the language of its controller; files for the controllers themselves are in
    ``controller/``. ``margins``: results of the proof by name, as text; they go into the headers' comments
    only. Raises :class:`TandemError` with codes ``post.*`` when the plan cannot be written.
    """
    return written(plan, problem, margins).files


@dataclasses.dataclass(frozen=True)
class Written:
    """Program ``files`` {relative name: text}, and the ``clocks`` {operation's index: (2, K)} of operations
    whose moves take longer in them than planned: places, 3.5 being half way from target 3 to target 4, and
    when [s] they are passed."""

    files: dict[str, str]
    clocks: Mapping[int, FloatArray]


def written(plan: Plan, problem: Problem, margins: Mapping[str, str] | None = None) -> Written:
    """As :func:`programs`, with what the process has to know of their clocks."""
    return _texts(_job(plan, problem), plan, problem, margins or {})


def refusals(problem: Problem, targets: Sequence[Targets]) -> tuple[Issue, ...]:
    """Why no program can be written for these targets, one an operation, however they are planned."""
    alone = problem.cell.controller.sync == "handshake"
    return (
        *controller_refusals(problem, targets),
        *spline_blocks.spline_refusals(problem, targets),
        *name_refusals(problem, targets),
        *(handshake_refusals(problem, targets) if alone else ()),
    )


def notes(plan: Plan, problem: Problem) -> tuple[Issue, ...]:
    """What the user should know of the programs beside their text: the drift of arms that meet by handshake,
    and what is left to a KUKA controller.

    Raises as :func:`programs` does.
    """
    krl_spoken = any(map(speaks_krl, problem.cell.arms))
    if problem.cell.controller.sync != "handshake" and not krl_spoken:
        return ()
    job = _job(plan, problem)
    files = _texts(job, plan, problem, {}).files if krl_spoken else {}
    return (*handshake.drift_issues(job), *krl_files.notes(job, plan, problem, files))


def _job(plan: Plan, problem: Problem) -> Job:
    issues = controller_refusals(problem, [operation.targets for operation in plan.operations])
    if issues:
        raise TandemError(issues)
    return build(plan, problem)


def _texts(job: Job, plan: Plan, problem: Problem, margins: Mapping[str, str]) -> Written:
    families = {task.robot.family for task in job.tasks}
    out = rapid_program.texts(job, plan, problem, margins) if "ABB" in families else {}
    out |= krl_program.texts(job, plan, problem, margins) if "KUKA" in families else {}
    out |= ur_program.texts(job, plan, problem, margins) if "UR" in families else {}
    driven, clocks = trajectories.texts(job, plan, problem) if "ROS" in families else ({}, {})
    return Written(out | driven | controller_texts(job, plan, problem), clocks)
