"""A search: the values of parameters are varied towards a measure, by Optuna, while several runs go on at once."""

from __future__ import annotations

import logging
import math
from collections import deque
from typing import TYPE_CHECKING, Any, Final

from carla_recap.errors import MissingExtra
from carla_recap.fleet.campaign.plan import CampaignRun, ParameterRange, run_of

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Mapping, Sequence

    from optuna import Study, Trial
    from optuna.distributions import BaseDistribution

    from carla_recap.fleet.campaign import Campaign, FinishedRun
    from carla_recap.fleet.campaign.plan import Value
    from carla_recap.queries.measures import Measure

_ATTEMPTS: Final = 20  # values that are proposed for each run, since some were proposed before
_DIGITS: Final = 4  # of a share of a range


def search(
    campaign: Campaign,
    seeds: Sequence[int],
    parameters: Mapping[str, Sequence[Value] | ParameterRange],
    objective: Measure,
    count: int,
    *,
    is_maximized: bool = False,
) -> Generator[FinishedRun]:
    """Yield the runs of a search, as they are finished.

    The values of each run depend on the results of those that are finished when it begins. With one worker, the same search
    makes the same runs.

    Runs have the seeds in turn, and there are fewer than `count` if all values of the parameters have been tried. The
    objective is to be small, or great if `is_maximized`. A run without a value of it counts as the worst; one that fails
    does not count.
    """
    try:
        import optuna
    except ImportError:
        raise MissingExtra("a search", "search") from None
    logging.getLogger("optuna").setLevel(logging.WARNING)
    sampler = optuna.samplers.TPESampler(seed=0, constant_liar=True)
    study = optuna.create_study(direction="maximize" if is_maximized else "minimize", sampler=sampler)
    worst = float("-inf" if is_maximized else "inf")
    proposals = _Proposals(study, {name: _distribution(given) for name, given in parameters.items()})
    for finished in campaign.run(proposals.runs(seeds, campaign.folder.location, count)):
        result = finished.report.results.get(objective.name)
        failed = finished.report.error is not None
        proposals.tell(finished.run, None if failed else worst if result is None else result.value)
        yield finished


class _Proposals:
    """The runs that a study proposes by distributions of parameters, no two alike."""

    def __init__(self, study: Study, distributions: dict[str, BaseDistribution]) -> None:
        self._study = study
        self._distributions = distributions
        self._trials: deque[Trial] = deque()  # of the runs that are not finished
        self._values: dict[str, float | None] = {}

    def runs(self, seeds: Sequence[int], out: str, count: int) -> Iterator[CampaignRun]:
        """Yield runs, each with values that are proposed when it is asked for."""
        made = 0
        for _ in range(count * _ATTEMPTS):
            if made == count:
                return
            trial = self._study.ask(self._distributions)
            values = {name: _rounded(value, self._distributions[name]) for name, value in trial.params.items()}
            run = run_of(seeds[made % len(seeds)], values, out)
            if run.name in self._values:
                self._tell(trial, self._values[run.name])
                continue
            self._values[run.name] = None
            self._trials.append(trial)
            made += 1
            yield run

    def tell(self, run: CampaignRun, value: float | None) -> None:
        """Report the value of the earliest run that is not finished; None if it has failed."""
        self._values[run.name] = value
        self._tell(self._trials.popleft(), value)

    def _tell(self, trial: Trial, value: float | None) -> None:
        from optuna.trial import TrialState

        self._study.tell(trial, value, state=TrialState.FAIL if value is None else None)


def _rounded(value: Any, within: Any) -> Any:
    """Return a proposed value, a float of a range rounded to one of at least 10,000 values in this range."""
    if not isinstance(value, float) or not hasattr(within, "high"):  # one of a list is as it is given
        return value
    digits = _DIGITS - math.floor(math.log10(within.high - within.low))
    return min(max(round(value, digits), within.low), within.high)


def _distribution(given: Sequence[Value] | ParameterRange) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    if not isinstance(given, ParameterRange):
        return CategoricalDistribution(tuple(given))
    if isinstance(given.low, int) and isinstance(given.high, int):
        return IntDistribution(given.low, given.high)
    return FloatDistribution(given.low, given.high)
