from coopqp.assessment import assess
from coopqp.metric import Metric, Trace, spec


@spec
class TaskError(Metric):
    """Each task's error at its end; a force's largest of the last 0.2 s."""

    unit = "the task's own"

    def measure(self, trace: Trace) -> dict[str, float]:
        """By task name."""
        return {task.name: task.error for task in assess(trace).tasks}
