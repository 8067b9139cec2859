#! python 3
"""Tandem Panels: the panels of a building element.

In: client, element (str), refresh (bool). Out: ids, meshes, orders, states, jobs.
"""

import tandem_grasshopper

ids, meshes, orders, states, jobs = tandem_grasshopper.panels(ghenv, client, element, refresh)
