#! python 3
"""Tandem Divide: divides a building element into panels.

In: client, definition (no type hint), mesh (Mesh), files (str, list access), run (bool),
cancel (bool).
Out: element, state, issues.
"""

import tandem_grasshopper

element, state, issues = tandem_grasshopper.divide(ghenv, client, definition, mesh, files, run, cancel)
