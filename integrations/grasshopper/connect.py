#! python 3
"""Tandem Connect: connects to a service.

In: url (str), token (str). Out: client, version.
"""

import tandem_grasshopper

client, version = tandem_grasshopper.connect(ghenv, url, token)
