"""References of Tandem's own plug-ins: strings that no type checker sees."""

from __future__ import annotations

import dataclasses

import pytest

from planner.languages.writing.language import Writer
from planner.processes import registry
from planner.programs.language import Reader
from planner.proof.contribution import ProofOfProcess
from planner.proof.language_contribution import ProofOfLanguage
from planner.report.plugin_contributions import ReportOfLanguage, ReportOfProcess
from planner.runtime import plugins
from planner.runtime.plugins import BUILT_IN, Language, PluginError, Process
from planner.targets import Job

TYPES: dict[type[Process | Language], dict[str, type]] = {
    Process: {"claims": tuple, "proof": ProofOfProcess, "report": ReportOfProcess},
    Language: {"reader": Reader, "writer": Writer, "proof": ProofOfLanguage, "report": ReportOfLanguage},
}
PLUGINS = [(kind, name) for kind in TYPES for name in BUILT_IN[kind.GROUP]]


@pytest.mark.parametrize(("kind", "name"), PLUGINS, ids=[name for _, name in PLUGINS])
def test_every_reference_names_something(kind: type[Process | Language], name: str) -> None:
    plugin = plugins.installed(kind)[name].plugin
    assert isinstance(plugin, kind)
    for field in dataclasses.fields(plugin):
        value = getattr(plugin, field.name)
        if isinstance(value, str) and ":" in value:
            plugins.load(value, TYPES[kind].get(field.name, object))
    if isinstance(plugin, Process):
        assert issubclass(plugins.load(plugin.job, type), Job)
        assert registry.schemas()[name] is plugins.load(plugin.schema, type)


@pytest.mark.parametrize(
    ("reference", "reason"),
    [
        ("planner.no_such_module:X", "cannot be imported (ModuleNotFoundError"),
        ("planner.runtime.plugins:NOTHING", "cannot be imported (AttributeError"),
        ("planner.runtime.plugins:BUILT_IN", "is dict, not builtins.tuple"),
    ],
)
def test_a_reference_that_names_nothing_is_refused(reference: str, reason: str) -> None:
    with pytest.raises(PluginError) as caught:
        plugins.load(reference, tuple)
    assert reason in str(caught.value)


def test_no_two_languages_share_a_family_or_an_ending() -> None:
    languages = plugins.usable(Language).values()
    for some in (
        [family for language in languages for family in language.families],
        [ending for language in languages for ending in language.file_endings],
    ):
        assert len(some) == len(set(some))
