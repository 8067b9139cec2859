#! python 3
"""Tandem Job: checks a problem, or plans it.

In: client, problem (no type hint), mesh (Mesh), curves (Curve, list access), files (str, list access),
check (bool), run (bool), cancel (bool).
Out: job, state, issues.
"""

import tandem_grasshopper

job, state, issues = tandem_grasshopper.job(ghenv, client, problem, mesh, curves, files, check, run, cancel)
