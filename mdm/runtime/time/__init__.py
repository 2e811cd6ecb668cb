"""Time: clocks, virtual ones among them, and the scheduler that makes ticks of it."""
