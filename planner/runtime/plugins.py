"""Plug-in points: manufacturing processes and robot languages.

A plug-in is an object (:class:`Process` or :class:`Language`) that names its parts by references such as
``"planner.processes.forming.plan.job:FormingJob"``. A reference is imported on first use. A lower layer such
as the proof can therefore use a part of a plug-in without an import statement for it, and reading a problem
imports neither planner nor proof.

Plug-ins of Tandem are listed in :data:`BUILT_IN`. Plug-ins of other packages are found by their entry
points in the groups ``tandem.processes`` and ``tandem.languages``. The name of an entry point is the name
of the plug-in. The object of an entry point is a :class:`Process` or a :class:`Language`.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, ClassVar, Final, TypeVar

T = TypeVar("T")
Reference = str
"""Name of a module and of an object in it, ``"package.module:object"``."""


@dataclasses.dataclass(frozen=True)
class Process:
    """A manufacturing process. All attributes are references; None stands for a part that it does not have.

    Attributes:
        schema: Schema of the operation, a pydantic model with the fields ``name``, ``process`` and ``arms``
            and the method ``leaves(stock)``, which returns the stock as the next operation finds it.
        job: Subclass of :class:`planner.targets.Job`: its targets, and the claims that must hold.
        claims: Tuple of the kinds of claims that only this process makes.
        codes: Dictionary of issue codes and their :class:`planner.issue_codes.IssueCode`.
        proof: :class:`planner.proof.contribution.ProofOfProcess`: facts and rules.
        report: :class:`planner.report.plugin_contributions.ReportOfProcess`: key figures, charts and setup
            sheet.
        wider: :data:`planner.reading.size_advice.RequiredWidening`: function that returns how much larger an
            opening must be that was refused.
    """

    GROUP: ClassVar[str] = "tandem.processes"

    schema: Reference
    job: Reference
    claims: Reference | None = None
    codes: Reference | None = None
    proof: Reference | None = None
    report: Reference | None = None
    wider: Reference | None = None


@dataclasses.dataclass(frozen=True)
class Language:
    """A robot language.

    Attributes:
        title: Name of the language in messages.
        families: Families of robots whose controllers read the language.
        endings: Endings of the names of program files, in lower case, with the dot.
        other_endings: Endings of other text files of the language, such as lists of programs.
        utf_8: Endings of files that the controller reads as UTF-8 without byte order mark.
        comment: Character that starts a comment.
        codes: Dictionary of issue codes and their :class:`planner.issue_codes.IssueCode`.
        reader: :class:`planner.programs.language.Reader`: reads programs.
        writer: :class:`planner.languages.writing.language.Writer`: refuses jobs, and writes programs.
        proof: :class:`planner.proof.language_contribution.ProofOfLanguage`: rules about the text.
        report: :class:`planner.report.plugin_contributions.ReportOfLanguage`: rows of the setup sheet.
    """

    GROUP: ClassVar[str] = "tandem.languages"

    title: str
    families: tuple[str, ...]
    endings: tuple[str, ...]
    reader: Reference
    writer: Reference
    other_endings: tuple[str, ...] = ()
    utf_8: tuple[str, ...] = ()
    comment: str = "#"
    codes: Reference | None = None
    proof: Reference | None = None
    report: Reference | None = None

    @property
    def file_endings(self) -> tuple[str, ...]:
        """Endings of all text files of the language."""
        return (*self.endings, *self.other_endings)


Plugin = Process | Language

BUILT_IN: Final[Mapping[str, Mapping[str, Reference]]] = {
    Process.GROUP: {
        "forming": "planner.processes.forming:PROCESS",
        "elastic_wire": "planner.processes.hotwire:ELASTIC_WIRE",
        "straight_wire": "planner.processes.hotwire:STRAIGHT_WIRE",
        "milling": "planner.processes.milling:PROCESS",
        "trim": "planner.processes.trim:PROCESS",
        "targets": "planner.processes.poses:PROCESS",
    },
    Language.GROUP: {
        "rapid": "planner.languages.rapid:LANGUAGE",
        "krl": "planner.languages.krl:LANGUAGE",
        "urscript": "planner.languages.urscript:LANGUAGE",
        "trajectories": "planner.languages.trajectories:LANGUAGE",
    },
}
"""References of Tandem's plug-ins by name, for each group. Their order is the order of the plug-ins."""


class PluginError(Exception):
    """A plug-in, or a part of it, cannot be used. The message is a clause, such as "cannot be imported"."""


@dataclasses.dataclass(frozen=True)
class LoadedPlugin:
    """Result of loading a plug-in.

    Attributes:
        plugin: The plug-in, or None if it cannot be used.
        owner: Origin of the plug-in: "Tandem", or the name of a package.
        fault: Reason why it cannot be used, a sentence without full stop; "" if it can.
    """

    plugin: Any
    owner: str
    fault: str = ""


def load(reference: Reference, kind: type[T]) -> T:
    """Import the object of a reference, and check its type.

    Args:
        reference: Module and object, as ``module:object``.
        kind: Required type of the object.

    Raises:
        PluginError: The module cannot be imported, has no such object, or the object is of another type.
    """
    module, _, name = reference.partition(":")
    try:
        loaded = getattr(import_module(module), name)
    except Exception as error:  # code of another package may raise anything
        raise PluginError(f"cannot be imported ({type(error).__name__}: {error})") from error
    if not isinstance(loaded, kind):
        raise PluginError(f"is {type(loaded).__name__}, not {kind.__module__}.{kind.__name__}")
    return loaded


@functools.cache
def installed(kind: type[Plugin]) -> Mapping[str, LoadedPlugin]:
    """Load all plug-ins of a kind, by name: Tandem's, then those of other packages in alphabetical order.

    A plug-in of another package that cannot be imported is present with a fault. If two plug-ins have the
    same name, neither of them can be used.

    Args:
        kind: :class:`Process` or :class:`Language`.
    """
    plugins = {
        name: LoadedPlugin(load(reference, kind), "Tandem")
        for name, reference in BUILT_IN[kind.GROUP].items()
    }
    noun = kind.__name__.lower()
    for point in sorted(
        entry_points(group=kind.GROUP), key=lambda entry_point: (entry_point.name, entry_point.value)
    ):
        owner = f"package {point.dist.name}" if point.dist is not None else point.value
        if point.name in plugins:
            message = f"the {noun} {point.name!r} is claimed by {plugins[point.name].owner} and by {owner}"
            hint = "uninstall one of them, or give its entry point another name"
            plugins[point.name] = LoadedPlugin(None, plugins[point.name].owner, f"{message}; {hint}")
            continue
        try:
            plugins[point.name] = LoadedPlugin(load(point.value.partition("[")[0].strip(), kind), owner)
        except PluginError as error:
            message = f"the {noun} {point.name!r} of {owner} {error}"
            plugins[point.name] = LoadedPlugin(
                None, owner, f"{message}; repair or uninstall {owner} ({point.value})"
            )
    return plugins


def usable(kind: type[T]) -> dict[str, T]:
    """Return the plug-ins of a kind that can be used, by name, in the order of :func:`installed`."""
    all_plugins = installed(kind)  # type: ignore[arg-type]
    return {name: loaded.plugin for name, loaded in all_plugins.items() if loaded.plugin is not None}


def language_of(family: str) -> Language | None:
    """Return the language that controllers of a robot family read, or None if there is none."""
    return next((language for language in usable(Language).values() if family in language.families), None)


def is_built_in(kind: type[Plugin], name: str) -> bool:
    """Return whether a plug-in is one of Tandem's."""
    return name in BUILT_IN[kind.GROUP]


def parts(kind: type[Plugin], member: str, part: type[T], names: frozenset[str] | None = None) -> Iterator[T]:
    """Yield the part with a name of each plug-in that has such a part.

    A part that two plug-ins share is yielded once.

    Args:
        kind: :class:`Process` or :class:`Language`.
        member: Attribute of the plug-in that refers to the part, such as ``"proof"``.
        part: Required type of the part.
        names: Names of the plug-ins of other packages to include, None for all. Tandem's are always included.

    Raises:
        PluginError: A part cannot be loaded.
    """
    yielded: set[Reference] = set()
    for name, plugin in usable(kind).items():
        reference = getattr(plugin, member)
        is_included = is_built_in(kind, name) or names is None or name in names
        if reference is not None and reference not in yielded and is_included:
            yielded.add(reference)
            yield part_of(kind, name, member, part)


def part_of(kind: type[Plugin], name: str, member: str, part: type[T]) -> T:
    """Load one part of a plug-in. The plug-in must be usable and must have such a part.

    Args:
        kind: :class:`Process` or :class:`Language`.
        name: Name of the plug-in.
        member: Attribute of the plug-in that refers to the part, such as ``"proof"``.
        part: Required type of the part.

    Raises:
        PluginError: The part cannot be loaded. The message is a sentence without full stop, not a clause.
    """
    loaded = installed(kind)[name]  # type: ignore[arg-type]
    try:
        return load(getattr(loaded.plugin, member), part)
    except PluginError as error:
        message = f"the {member} of the {kind.__name__.lower()} {name!r} of {loaded.owner} {error}"
        raise PluginError(f"{message}; repair or uninstall {loaded.owner}") from error


@functools.cache
def loadable(kind: type[Plugin], member: str, part: type[T]) -> Mapping[str, T]:
    """Return the part with a name of every plug-in, by name of the plug-in.

    Plug-ins without such a part, and parts that cannot be loaded, are left out.

    Args:
        kind: :class:`Process` or :class:`Language`.
        member: Attribute of the plug-in that refers to the part, such as ``"codes"``.
        part: Required type of the part.
    """
    out = {}
    for name, plugin in usable(kind).items():
        if getattr(plugin, member) is not None:
            with contextlib.suppress(PluginError):
                out[name] = part_of(kind, name, member, part)
    return out
