"""A header may change only comments of proven programs."""

import pytest

from planner.proof.same_program import is_same_program
from tests.proof import small_job
from tests.work import count_calls

TEXT = """MODULE M
  ! header

  CONST string s:="a ! b";
  PROC main()
    MoveL p,v10,fine,t;
  ENDPROC
ENDMODULE
"""


@pytest.mark.parametrize(
    ("original", "after", "same"),
    [
        ("! header", "! header\n  ! Proven: clearance 3 mm.", True),
        ("  ! header\n", "", True),
        ("  PROC", "\tPROC", True),
        ("MoveL p,v10", "MoveL p, ! slowly\n    v10", True),
        ("MoveL p", "movel P", True),
        ("MoveL p", "MoveL q", False),
        ("    MoveL p", "!   MoveL p", False),
        ("a ! b", "a ! c", False),
        ("! header", "! header\n  VAR num n;", False),
        ("\n\n", "\n\f\n", False),
        ("ENDPROC", "! ENDPROC", False),
    ],
)
def test_only_comments_and_white_space(original, after, same):
    assert TEXT.count(original) == 1
    assert is_same_program({"a.mod": TEXT}, {"a.mod": TEXT.replace(original, after)}) == same


KRL = """&ACCESS RVP
&REL 1
DEF a()
; header
$OUT[17]=FALSE ; doSpindle
;? Is the way clear?
HALT
; Segment cut/front: 2 moves, 1 s.
SLIN {X 1.0000,Y 2.0000,Z 3.0000,A 4.00000,B 5.00000,C 6.00000} C_SPL
END
"""


@pytest.mark.parametrize(
    ("original", "after", "same"),
    [
        ("; header", "; header\n; Proven: clearance 3 mm.", True),
        ("; header\n", "", True),
        ("; doSpindle", "; doCoolant", True),
        ("\n", "\r\n", True),
        ("2 moves, 1 s", "3 moves, 2 s", True),
        ("$OUT[17]=FALSE", "$OUT[17]=TRUE", False),
        ("$OUT[17]", "; $OUT[17]", False),
        ("X 1.0000", "X 1.0001", False),
        ("way clear", "way closed", False),
        (";? Is", "; Is", False),
        ("cut/front", "cut/back", False),
        ("&REL 1", "&REL 2", False),
        ("END\n", "HALT\nEND\n", False),
    ],
)
def test_krl_comments_that_the_proof_reads_count(original, after, same):
    assert is_same_program({"a.src": KRL}, {"a.src": KRL.replace(original, after)}) == same


def test_no_file_more_or_less():
    assert not is_same_program({"a.mod": TEXT}, {"a.mod": TEXT, "b.mod": TEXT})


def test_long_programs_are_compared_with_work_in_proportion():
    text = small_job.programs()["T_ROB1/TandemCut1_1.mod"] * 200
    _, few = count_calls(
        is_same_program, {"a.mod": text[: len(text) // 10]}, {"a.mod": text[: len(text) // 10]}
    )
    same, many = count_calls(is_same_program, {"a.mod": text}, {"a.mod": "! Proven.\n" + text})
    assert same
    assert many < 10.5 * few
