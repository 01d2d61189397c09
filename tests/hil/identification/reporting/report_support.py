"""An identification and a validation made from synthetic signals, for tests of reports."""

import numpy as np

from liftgate_hil.identification.result import (
    Estimate,
    Experiment,
    Identification,
    LikelihoodProfile,
    PhaseErrors,
    Series,
    Validation,
)

LAGS = 25
COLUMNS = ("left_current_a", "left_speed_rps", "left_position_rev", "gate_angle_deg")
HOSTILE = "<script>alert('x')</script>&\"$\\frac{a}\x1b[31m\udcff\u202e_"


def correlation(one, other, lags):
    """Correlation of two signals as they are, their means included, at shifts from -lags to lags."""
    size = np.sqrt(np.sum(one**2) * np.sum(other**2))
    middle = len(one) - 1
    return np.correlate(one, other, "full")[middle - lags : middle + lags + 1] / size


def series_of(output, times, measured, simulated, before, voltage):
    """Series of an output; `before` are the values of the initial model, or None."""
    error = measured - simulated
    spread = np.linalg.norm(measured - measured.mean())

    def fit(model):
        return float(100.0 * (1.0 - np.linalg.norm(measured - model) / spread))

    own = correlation(error, error, LAGS)[LAGS:]
    band = 2.58 / np.sqrt(len(times))
    thirds = np.array_split(error, 3)
    phases = {
        name: PhaseErrors(float(np.sqrt(np.mean(part**2))), float(np.max(np.abs(part))), len(part))
        for name, part in zip(("start", "running", "end"), thirds, strict=True)
    }
    return Series(
        output,
        times,
        measured,
        simulated,
        before if before is not None else np.empty(0),
        fit(simulated),
        fit(before) if before is not None else float("nan"),
        float(np.mean(error)),
        float(np.std(error) / np.sqrt(len(error))),
        float(np.sqrt(np.mean(error**2))),
        float(np.max(np.abs(error))),
        phases,
        own,
        correlation(error, voltage - voltage.mean(), LAGS),
        float(band),
        bool(np.mean(np.abs(own[1:]) > band) < 0.05),
    )


def opening(times, voltage, resistance, inertia):
    """Signals of a motor that starts, runs and stops: current, speed, position, gate angle."""
    rise = 1.0 - np.exp(-times / inertia)
    end = 1.0 / (1.0 + np.exp((times - 4.5) * 30.0))
    current = voltage / resistance * np.exp(-times / inertia) + 1.1 + 0.2 * np.sin(times)
    speed = 12.0 * 11.0 * rise * end
    position = np.cumsum(speed) * (times[1] - times[0]) if len(times) > 1 else speed
    return current, speed, position, position * 0.15


def experiment_of(name, samples, seed, columns=COLUMNS, with_before=True):
    """Experiment of 5 s of this many samples, with one noisy series for each column."""
    rng = np.random.default_rng(seed)
    times = np.linspace(0.0, 5.0, samples)
    voltage = np.where(times > 0.05, 12.0 + 0.3 * np.sin(7 * times), 0.0)
    true = opening(times, voltage, 2.1, 0.1)
    final = opening(times, voltage, 2.15, 0.101)
    first = opening(times, voltage, 0.7, 0.06)
    noise = (0.2, 2.1, 0.6, 0.05)
    rows = []
    for i, column in enumerate(columns):
        measured = true[i] + noise[i] * rng.standard_normal(samples)
        before = first[i] * 1.08 if with_before else None
        rows.append(series_of(column, times, measured, final[i], before, voltage))
    return Experiment(name, times, voltage, tuple(rows))


def estimates():
    return (
        Estimate("motor.resistance", "R", "ohm", 2.12797, 0.0217914, 0.708, 0.1, 10.0, True),
        Estimate(
            "motor.inductance", "L", "H", 4.20318e-5, 61.14862e-5, 4.37e-5, 1e-6, 1e-2, False,
            "its standard deviation is 15 times its value; the current settles within one sample",
        ),
        Estimate(
            "motor.rotor_inertia", "J", "kg m²", 1.47e-5, 2.81633e-7, 1.28e-5, 1e-6, 1e-3, True
        ),
        Estimate("motor.load_torque", "M0", "N m", 0.001, 0.00043, 0.00124, 0.001, 0.1, True,
                 "at its lower bound"),
        Estimate("hinge.friction", "Mh", "N m", 0.3, float("inf"), 0.0, 0.0, float("inf"), False),
    )  # fmt: skip


def states():
    return (
        Estimate("open.csv: left_position", "x3", "rev", 0.12, 0.011, 0.0, -1.0, 1.0, True),
        Estimate("open.csv: gate_angle", "φ", "deg", 0.0, float("inf"), 0.0, -1.0, 1.0, False),
    )


def profiles():
    values = np.linspace(2.05, 2.2, 21)
    flat = np.geomspace(1e-6, 1e-3, 21)
    return (
        LikelihoodProfile("motor.resistance", values, ((values - 2.12797) / 0.0218) ** 2, 2.085, 2.171),
        LikelihoodProfile(
            "motor.inductance", flat, np.clip((flat - 4e-5) / 6e-4, 0, None) ** 2,
            float("nan"), float("nan"),
        ),
    )  # fmt: skip


def identification(samples=2000, names=("open.csv", "close.csv"), columns=COLUMNS, **changes):
    """An identification like the thesis's table 4.1, some parameters of which are not identifiable."""
    found = estimates()
    count = len(found)
    rng = np.random.default_rng(1)
    factor = rng.standard_normal((count, count)) + 0.5
    wide = factor @ factor.T
    scale = np.sqrt(np.diag(wide))
    together = wide / np.outer(scale, scale)
    together[0, 2] = together[2, 0] = -0.95
    std = np.array([each.std for each in found])
    with np.errstate(invalid="ignore"):
        covariance = together * np.outer(std, std)
    size = len(columns)
    noise = np.diag([0.0491, 4.5906, 0.401, 0.0025][:size])
    fields = {
        "model": "full",
        "vehicle": "suv",
        "outputs": tuple(columns),
        "parameters": found,
        "initial_states": states(),
        "covariance": covariance,
        "correlation": together,
        "noise_variance": noise,
        "loss": float(np.linalg.det(noise)),
        "loss_initial": 13.7,
        "fpe": 2.3e-4,
        "aic": -8.4213,
        "aicc": -8.42,
        "bic": -8.39,
        "condition_number": 3.2e7,
        "inseparable": ("motor.torque_constant and motor.efficiency: only their product is told",),
        "stop_reason": "the step became shorter than 1e-6 of the parameters",
        "iterations": 9,
        "evaluations": 61,
        "seconds": 12.34,
        "covariance_kind": "robust (autocorrelated residuals)",
        "history": np.geomspace(13.7, 2.2e-4, 10),
        "experiments": tuple(experiment_of(name, samples, seed, columns) for seed, name in enumerate(names)),
        "profiles": profiles(),
        "notes": ("open.csv: 3 samples left out: outliers", "decimated from 10 kHz to 1 kHz"),
    }
    return Identification(**{**fields, **changes})


def validation(samples=2000, names=("open.csv", "close.csv"), columns=COLUMNS):
    """The validation result of the same experiments."""
    experiments = tuple(
        experiment_of(name, samples, seed, columns, with_before=False) for seed, name in enumerate(names)
    )
    known = {"model": "full", "vehicle": "suv", "experiments": experiments, "initial_states": states()}
    return Validation(**known, notes=("close.csv: decimated",))


def nothing():
    """An identification result without parameters and experiments."""
    return identification(
        50, names=(), columns=(), parameters=(), initial_states=(), profiles=(), inseparable=(),
        notes=(), covariance=np.empty((0, 0)), correlation=np.empty((0, 0)), history=np.empty(0),
    )  # fmt: skip
