"""Possible executions of a task: independent of its splitting, with work that grows linearly."""

from planner.languages.rapid.reader.flow import error_handlers, main_steps, task_flow
from planner.languages.rapid.reader.reader import read_task
from planner.programs.steps import MoveStep
from tests.work import count_calls

MOVE = r"MoveL [[10.5,-2,3],[0,1,0,0],[0,0,-1,1],[9E9,9E9,9E9,9E9,9E9,9E9]],v100\T:=0.25,z1,tool0;"

HANDLER = "ERROR\n    StopMove;\n    away;\n    EXIT;\n"


def modules(procedures, each, files):
    """Return the texts of a task whose moves are in procedures of several modules, called in order."""
    calls = "".join(f"    part_{i};\n" for i in range(procedures))
    texts = {
        "Whole.mod": f"MODULE Whole\n  PROC main()\n{calls}  {HANDLER}  ENDPROC\n"
        "  PROC away()\n    SetDO doPower,0;\n  ENDPROC\nENDMODULE\n"
    }
    for k in range(files):
        body = "".join(
            f"  PROC part_{i}()\n{(f'    {MOVE}' + chr(10)) * each}  {HANDLER}  ENDPROC\n"
            for i in range(k, procedures, files)
        )
        texts[f"Part{k}.mod"] = f"MODULE Part{k}\n{body}ENDMODULE\n"
    return texts


def test_all_that_runs_and_may_run():
    task = read_task(modules(6, 3, 2))
    assert not task.faults
    found = task_flow(task.modules)
    assert [step.line for step in found.steps] == [step.line for step in main_steps(task.modules)]
    assert len([step for step in found.steps if isinstance(step, MoveStep)]) == 18
    assert found.handlers.keys() == error_handlers(task.modules).keys()
    assert len(found.handlers) == 7
    assert found.undos == {}
    parts = {(f"Part{i % 2}", f"part_{i}") for i in range(6)}
    assert found.called == parts | {("Whole", "main"), ("Whole", "away")}


def test_many_procedures_take_work_in_proportion():
    _, few = count_calls(task_flow, read_task(modules(100, 10, 25)).modules)
    found, many = count_calls(task_flow, read_task(modules(1000, 10, 25)).modules)
    assert len(found.called) == 1002
    assert len(found.steps) == 10_000
    assert many < 10.5 * few
