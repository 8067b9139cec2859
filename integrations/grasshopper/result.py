#! python 3
"""Tandem Result: the results of a job.

In: client, job (str), folder (str), refresh (bool).
Out: state, issues, planes, joints, names, times, targets, blocks, part, programs, report, replay.
"""

import tandem_grasshopper

found = tandem_grasshopper.result(ghenv, client, job, folder, refresh)
state, issues, planes, joints, names, times, targets, blocks, part, programs, report, replay = found
