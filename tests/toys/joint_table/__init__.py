"""Joint tables: a CSV file for each arm. The first cell of each row says what it is::

    digest,<digest of the problem>
    arm,<name>,<robot>
    base,<x>,<y>,<z> [mm],<qw>,<qx>,<qy>,<qz>
    tool,<name>,<TCP: the same>,<mass> [kg],<centre of gravity> [mm]
    block,<the same: where the block stands>
    ask,<question that the operator answers with OK>
    row,<segment, empty outside of work>,<time> [s],<joints> [deg]

The first row has the time 0 and states where the arm has to stand. To each other row the arm goes from rest
to rest, straight in joint space and by a cubic in time, and arrives at the time of the row.
"""

from typing import Final

from planner.issue_codes import IssueCode
from planner.runtime.plugins import Language

CODES: Final = {
    "joint_table.job": IssueCode("a job that joint tables cannot state"),
    "joint_table.start": IssueCode("a joint table does not begin at home"),
    "joint_table.straight": IssueCode("between two rows of a joint table the tool leaves the straight way"),
}
LANGUAGE: Final = Language(
    title="joint tables",
    families=("joint_table",),
    endings=(".csv",),
    codes="tests.toys.joint_table:CODES",
    reader="tests.toys.joint_table.reader:READER",
    writer="tests.toys.joint_table.writer:WRITER",
    proof="tests.toys.joint_table.contributions:PROOF",
    report="tests.toys.joint_table.contributions:REPORT",
)
