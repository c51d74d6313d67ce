"""The skies that an observation is compared with: closed formulas, and the simulator."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from atmofit.checks import choice, in_range
from atmofit.colour import XYZ_to_linear_sRGB, xyY_to_XYZ
from atmofit.fit.unknowns import UNKNOWNS
from atmofit.geometry import HORIZON, DirectionGrid, Directions
from atmofit.models.preetham import PREETHAM_1999, PreethamModel
from atmofit.models.sky_model import SkyModel
from atmofit.observe.channels import Camera, weights
from atmofit.observe.observation import Observation
from atmofit.optics.atmosphere import Atmosphere
from atmofit.optics.continental import continental_air
from atmofit.sky.plan import Plan
from atmofit.sky.planning import plan_sky
from atmofit.sky.simulate import simulate_luminance, simulate_sky
from atmofit.typing import Reals, Scalar

AIRS = ("preetham1999", "continental")
SIMULATED_RANGE = (1.0, 30.0)
COARSEST = 5e-2  # rung of the ladder that a scan uses
_COLOUR_NM = tuple(float(λ) for λ in range(380, 781, 10))  # at which colours are integrated
_FEW = 12  # wavelengths, up to which interpolation saves nothing
_SUN = ("solar_zenith_angle", "solar_azimuth")
_OF_CONTINENT = (
    "angstrom_exponent", "single_scattering_albedo", "asymmetry", "scale_height", "ozone_dobson",
    "albedo",
)  # fmt: skip
Values = dict[str, Scalar]


class SimulatorModel(eqx.Module):
    """The simulator as a model of measured skies.

    Attributes:
        air: "preetham1999": the clear sky of the 1999 paper, with turbidity for its only unknown;
            "continental": `continental_air`, whose every number may be unknown. Static.
        orders: Scattering orders, 1 to 20, or "all". Static.
        rtol: Promised relative error, 5e-4 to 1. Static.
        plan: For the quantity that is observed; replaces `orders` and `rtol`. Static.
        ozone: Whether the continental air has ozone. Static.
        ground: Whether it has a ground that reflects. Static.
    """

    air: str = eqx.field(static=True, default="preetham1999")
    orders: int | str = eqx.field(static=True, default=2)
    rtol: float = eqx.field(static=True, default=1e-2)
    plan: Plan | None = eqx.field(static=True, default=None)
    ozone: bool = eqx.field(static=True, default=True)
    ground: bool = eqx.field(static=True, default=True)

    def __check_init__(self) -> None:
        """Check the air; orders and accuracy are checked where a plan is made."""
        choice("air", self.air, AIRS)

    def atmosphere(self, values: Values) -> Atmosphere:
        """The air of some values, by name."""
        if self.air == "preetham1999":
            return Atmosphere.from_turbidity(values["turbidity"])
        chosen = {name: values[name] for name in ("turbidity", *self._of_air)}
        absent: dict[str, Any] = {"ozone_dobson": None, "albedo": None}
        return continental_air(**(absent | chosen))

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of what may be searched for."""
        return ("turbidity", *self._of_air, *_SUN)

    @property
    def _of_air(self) -> tuple[str, ...]:
        if self.air == "preetham1999":
            return ()
        there = {"ozone_dobson": self.ozone, "albedo": self.ground}
        return tuple(name for name in _OF_CONTINENT if there.get(name, True))


Model = str | PreethamModel | SkyModel | SimulatorModel
Plate = tuple[tuple[float, ...] | None, Any]  # wavelengths, or None and channels


class AnalyticSky(eqx.Module):
    """Values by a closed formula."""

    model: PreethamModel | SkyModel
    observed: Plate = eqx.field(static=True)

    def __call__(self, values: Values, directions: Directions | DirectionGrid) -> Reals:
        """What is seen in some directions, on a last axis of channels."""
        wavelength_nm, channels = self.observed
        place = (values["turbidity"], values["solar_zenith_angle"], directions)
        if isinstance(self.model, PreethamModel):
            xyY = self.model(*place)
            return xyY[..., 2:] if channels == "luminance" else _colours(xyY_to_XYZ(xyY), channels)
        albedo = values["albedo"]
        if wavelength_nm is not None:
            return self.model.radiance(*place, wavelength_nm, albedo)
        if isinstance(channels, Camera):
            radiance = self.model.radiance(*place, _COLOUR_NM, albedo)
            return radiance @ jnp.asarray(weights(channels, _COLOUR_NM).T, radiance.dtype)
        return _colours(self.model.XYZ(*place, albedo), channels)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of what may be searched for."""
        ground = () if isinstance(self.model, PreethamModel) else ("albedo",)
        return ("turbidity", *ground, *_SUN)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Of the unknowns whose own range is another than the usual one."""
        ranges = {"turbidity": self.model.turbidity_range, "solar_zenith_angle": (0.0, HORIZON)}
        if isinstance(self.model, SkyModel):
            ranges["albedo"] = (0.0, self.model.dependence.largest_albedo)
        return ranges

    @property
    def precision(self) -> float:
        """Relative rounding."""
        return float(jnp.finfo(jnp.result_type(float)).eps)


class SimulatedSky(eqx.Module):
    """Values by the simulator."""

    model: SimulatorModel = eqx.field(static=True)
    plan: Plan = eqx.field(static=True)
    observed: Plate = eqx.field(static=True)

    def __call__(self, values: Values, directions: Directions | DirectionGrid) -> Reals:
        """What is seen in some directions, on a last axis of channels."""
        wavelength_nm, channels = self.observed
        atmosphere, sun = self.model.atmosphere(values), values["solar_zenith_angle"]
        if self.plan.quantity == "luminance":
            return simulate_luminance(atmosphere, sun, directions, plan=self.plan)[..., None]
        λ = _COLOUR_NM if wavelength_nm is None else wavelength_nm
        radiance = simulate_sky(atmosphere, sun, directions, λ, plan=self.plan)
        if wavelength_nm is not None:
            return radiance
        return radiance @ jnp.asarray(weights(channels, _COLOUR_NM).T, radiance.dtype)

    @property
    def unknowns(self) -> tuple[str, ...]:
        """Names of what may be searched for."""
        return self.model.unknowns

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Of the unknowns whose own range is another than the usual one."""
        return {"turbidity": SIMULATED_RANGE, "solar_zenith_angle": (0.0, HORIZON)}

    @property
    def precision(self) -> float:
        """Relative rounding."""
        return float(jnp.finfo(self.plan.dtype).eps)


Sky = AnalyticSky | SimulatedSky


def name_of(model: Model) -> str:
    """Of a model, for reports and for its errors."""
    if isinstance(model, str):
        return model
    if isinstance(model, SimulatorModel):
        plan = model.plan
        return f"simulator {model.air} {model.orders if plan is None else plan.orders}"
    return "fitted" if isinstance(model, PreethamModel) else "sky model"


def skies(model: Model, observation: Observation) -> tuple[Sky, Sky]:
    """What computes a model's sky as it was observed, and what computes it for a scan.

    Raises:
        ValueError: An unknown word, or a model that does not have what was observed.
    """
    observed = (observation.wavelength_nm, observation.channels)
    if isinstance(model, str):
        choice("model", model, ("preetham", "simulator"))
        model = PREETHAM_1999 if model == "preetham" else SimulatorModel()
    if isinstance(model, SimulatorModel):
        return _simulated(model, observed)
    _check_channels(model, observed)
    sky = AnalyticSky(jax.tree.map(jnp.asarray, model), observed)
    return sky, sky


def _check_channels(model: PreethamModel | SkyModel, observed: Plate) -> None:
    wavelength_nm, channels = observed
    spectral = wavelength_nm is not None or isinstance(channels, Camera)
    if isinstance(model, PreethamModel):
        if spectral:
            raise ValueError(
                "observation must be of luminance or colour for a model of the 1999 form, got "
                "spectra or a camera: use its to_luminance()"
            )
    elif spectral:
        if not model.wavelength_nm:
            raise ValueError("observation must be of colours for a model without wavelengths")
        asked = np.asarray(_COLOUR_NM if wavelength_nm is None else wavelength_nm)
        in_range("wavelength_nm", asked, model.wavelength_nm[0], model.wavelength_nm[-1], "nm")
    elif not model.colours:
        raise ValueError("observation must be of spectra for a model without colours")


def _simulated(model: SimulatorModel, observed: Plate) -> tuple[SimulatedSky, SimulatedSky]:
    wavelength_nm, channels = observed
    air = model.atmosphere({name: jnp.asarray(u.start) for name, u in UNKNOWNS.items()})
    of_luminance = wavelength_nm is None and channels == "luminance"
    plan = model.plan
    if plan is None:
        # In float32, whose rounding is far below any noise.
        if of_luminance and not air.absorbers:
            plan = plan_sky(
                air, quantity="luminance", orders=model.orders, rtol=model.rtol, dtype="float32"
            )
        else:
            plan = _spectral_plan(air, model.orders, model.rtol, wavelength_nm)
    allowed = ("luminance", "spectrum") if of_luminance else ("spectrum",)
    if plan.quantity not in allowed:
        raise ValueError(f'plan must be for quantity "{allowed[0]}", got "{plan.quantity}"')
    coarse = plan
    if plan.rtol < COARSEST:
        if plan.quantity == "luminance":
            coarse = plan_sky(
                air, quantity="luminance", orders=plan.orders, rtol=COARSEST, dtype=plan.dtype
            )
        else:
            coarse = _spectral_plan(air, plan.orders, COARSEST, wavelength_nm)
    return SimulatedSky(model, plan, observed), SimulatedSky(model, coarse, observed)


def _spectral_plan(
    air: Atmosphere, orders: int | str, rtol: float, wavelength_nm: tuple[float, ...] | None
) -> Plan:
    """A plan that interpolates between wavelengths where there are many."""
    few = wavelength_nm is not None and len(wavelength_nm) <= _FEW
    sun = np.array([0.0, HORIZON])
    return plan_sky(
        air, solar_zenith_angle=sun, orders=orders, rtol=rtol, dtype="float32", all_wavelengths=few
    )


def _colours(XYZ: Reals, channels: str) -> Reals:
    """Luminance, XYZ or linear sRGB."""
    if channels == "luminance":
        return XYZ[..., 1:2]
    return XYZ if channels == "XYZ" else XYZ_to_linear_sRGB(XYZ)
