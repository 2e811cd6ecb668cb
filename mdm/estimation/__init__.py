"""Estimation: a robot's model by its decisions, counted afterwards or watched as they come."""

from mdm.estimation.chains import Chain, Chains, Stay, chains_of, joined, returns_of
from mdm.estimation.drift import Alarm, DriftTest
from mdm.estimation.hidden import Evidence, Fit, Frequencies, Intervals, evidence_of, fit, frequencies, sample
from mdm.estimation.rates import Holding, Rates, durations_of, moran, rates_of
from mdm.estimation.recorded import chains_of_records, check_names, open_records
from mdm.estimation.reestimation import reestimated
from mdm.estimation.report import Report, as_data, as_text, statistics
from mdm.estimation.rows import Row, counted, probability_intervals, rate_intervals, transition_rows

__all__ = [
    "Alarm",
    "Chain",
    "Chains",
    "DriftTest",
    "Evidence",
    "Fit",
    "Frequencies",
    "Holding",
    "Intervals",
    "Rates",
    "Report",
    "Row",
    "Stay",
    "as_data",
    "as_text",
    "chains_of",
    "chains_of_records",
    "check_names",
    "counted",
    "durations_of",
    "evidence_of",
    "fit",
    "frequencies",
    "joined",
    "moran",
    "open_records",
    "probability_intervals",
    "rate_intervals",
    "rates_of",
    "reestimated",
    "returns_of",
    "sample",
    "statistics",
    "transition_rows",
]
