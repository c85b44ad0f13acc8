"""Recording a world: snapshots of its ticks, written by a process of their own."""
