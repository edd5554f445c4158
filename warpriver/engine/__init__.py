"""How a step is done: stages that are recorded and replayed, phases that own them, and the state that they share.

Nothing here knows what moves a channel. A process is one :class:`~warpriver.engine.phase.Phase`.
"""
