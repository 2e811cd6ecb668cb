"""Teams: one process per agent, which share what they see and decide as one.

A `Transport` carries the messages: a session of Zenoh between processes (`mdm.team.session`, which needs
``pip install 'mdm[team]'``), or a simulated network within one (`mdm.team.network`).
"""
