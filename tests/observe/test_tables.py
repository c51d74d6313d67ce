"""Observations from tables, and what is wrong with bad ones."""

import numpy as np
import pytest

import atmofit as af

VIEW, AZIMUTH = np.array([10.0, 40.0, 70.0, 80.0]), np.array([0.0, 90.0, 180.0, 270.0])
Y = np.array([5e3, 4e3, 6e3, 7e3])


def write_csv(path, columns, comment=""):
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(str(cell) for cell in row) for row in rows)]
    path.write_text(comment + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def table(**changes):
    columns = {
        "view_zenith_deg": VIEW,
        "relative_azimuth_deg": AZIMUTH,
        "sun_zenith_deg": np.full(4, 50.0),
        "luminance_cd_m2": Y,
    }
    columns |= changes
    return {name: values for name, values in columns.items() if values is not None}


def test_a_table_of_luminances(tmp_path):
    path = write_csv(tmp_path / "sky.csv", table(), "# measured on a roof\n")
    (sky,) = af.read_observations(path, relative_noise=0.03)
    np.testing.assert_allclose(sky.values, Y)
    np.testing.assert_allclose(sky.directions.view_zenith_angle, np.radians(VIEW))
    assert sky.solar_zenith_angle == pytest.approx(np.radians(50.0))
    np.testing.assert_allclose(sky.relative_noise, 0.03)
    assert np.asarray(sky.used).all()


def test_azimuths_from_north_and_rows_that_cannot_be_used(tmp_path):
    columns = table(
        relative_azimuth_deg=None,
        azimuth_deg=AZIMUTH + 95.0,
        sun_azimuth_deg=np.full(4, 95.0),
        luminance_cd_m2=["5000", "", "-1", "none"],
        relative_noise=[0.01, 0.01, 0.05, 0.05],
        used=[1, 1, 1, 1],
    )
    (sky,) = af.read_observations(write_csv(tmp_path / "sky.csv", columns))
    np.testing.assert_array_equal(sky.used, [True, False, False, False])
    np.testing.assert_allclose(sky.directions.relative_azimuth, np.radians(AZIMUTH), atol=1e-12)
    assert sky.relative_noise[0] == 0.01


def test_several_skies_colours_and_spectra(tmp_path):
    columns = table(luminance_cd_m2=None, X=Y, Y=1.1 * Y, Z=1.5 * Y, scan=[2, 2, 1, 1])
    skies = af.read_observations(write_csv(tmp_path / "sky.csv", columns))
    assert [sky.values.shape for sky in skies] == [(2, 3), (2, 3)]
    assert skies[0].channels == "XYZ"
    np.testing.assert_allclose(skies[1].values[:, 0], Y[2:])  # in the order of the rows
    spectra = table(luminance_cd_m2=None, radiance_650=Y * 1e-5, radiance_450=Y * 2e-5)
    (sky,) = af.read_observations(write_csv(tmp_path / "spectra.csv", spectra))
    assert sky.wavelength_nm == (450.0, 650.0)
    np.testing.assert_allclose(sky.values[:, 1], Y * 1e-5)


def test_netcdf_is_the_same(tmp_path):
    import xarray

    λ = np.array([450.0, 550.0])
    data = xarray.Dataset(
        {
            "view_zenith_deg": ("direction", VIEW),
            "relative_azimuth_deg": ("direction", AZIMUTH),
            "radiance": (("wavelength_nm", "direction"), np.outer([1e-5, 2e-5], Y)),
            "sun_zenith_deg": ((), 50.0),
        },
        coords={"wavelength_nm": λ},
    )
    data.to_netcdf(tmp_path / "sky.nc", engine="h5netcdf")
    (sky,) = af.read_observations(tmp_path / "sky.nc")
    assert sky.wavelength_nm == (450.0, 550.0)
    np.testing.assert_allclose(sky.values, np.outer(Y, [1e-5, 2e-5]))


def test_scans_leave_their_faulty_direction_out(tmp_path):
    view = np.repeat([78.0, 30.0], 4)
    np.savez(
        tmp_path / "scans.npz",
        wavelength_nm=np.arange(390, 711),
        radiance_W_m2_sr_nm=np.ones((2, 8, 321), np.float32) * np.arange(1, 3)[:, None, None],
        view_zenith_deg=view,
        view_azimuth_deg=np.tile(np.arange(0.0, 360.0, 90.0), 2),
        sun_zenith_deg=np.array([40.0, 50.0]),
        sun_azimuth_from_symmetry_deg=np.array([90.0, 100.0]),
        luminance_cd_m2=np.ones((2, 8)) * 4e3,
    )
    first, second = af.read_observations(tmp_path / "scans.npz")
    assert not first.used[0]
    assert np.asarray(first.used)[1:].all()
    assert isinstance(first.directions, af.Directions)
    assert first.directions.rings == (4, 4)
    assert second.directions.relative_azimuth[1] == pytest.approx(np.radians(350.0))
    spectra = af.read_observations(
        tmp_path / "scans.npz", spectral=True, wavelength_nm=(450.0, 550.5)
    )
    np.testing.assert_allclose(spectra[1].values, 2.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"view_zenith_deg": None}, "file must have a column view_zenith_deg"),
        ({"relative_azimuth_deg": None}, "must have a column relative_azimuth_deg or azimuth_deg"),
        ({"luminance_cd_m2": None}, "file must have a column luminance_cd_m2, columns X, Y, Z"),
        ({"sun_zenith_deg": None}, "solar_zenith_deg must be given"),
        ({"sun_zenith_deg": [50, 50, 51, 50]}, "sun_zenith_deg must be the same in every row"),
    ],
)
def test_tables_that_lack_something_are_refused(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        af.read_observations(write_csv(tmp_path / "sky.csv", table(**changes)))


def test_files_that_are_no_tables_are_refused(tmp_path):
    with pytest.raises(ValueError, match="file must exist"):
        af.read_observations(tmp_path / "absent.csv")
    with pytest.raises(ValueError, match=r"file must end in \.csv, \.nc, \.npz"):
        af.read_observations(tmp_path / "sky.txt")
    for name in ("a.csv", "a.nc", "a.npz"):
        (tmp_path / name).write_bytes(b"\x00\xff\xfe no table")
        with pytest.raises(ValueError, match="file must"):
            af.read_observations(tmp_path / name)


def test_tables_beyond_memory_are_refused_unread(tmp_path, monkeypatch):
    import xarray

    names = ("view_zenith_deg", "relative_azimuth_deg", "sun_zenith_deg", "luminance_cd_m2")
    data = xarray.Dataset({name: ("direction", np.ones(5000)) for name in names})
    packed = {name: {"zlib": True} for name in names}
    data.to_netcdf(tmp_path / "sky.nc", engine="h5netcdf", encoding=packed)
    monkeypatch.setattr("atmofit.observe.tables.LARGEST_ARRAYS", 150_000)
    with pytest.raises(ValueError, match="it holds 160000 bytes, more than 150000"):
        af.read_observations(tmp_path / "sky.nc")
