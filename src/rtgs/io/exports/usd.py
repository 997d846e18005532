"""USD with `UsdVol.ParticleField3DGaussianSplat` (OpenUSD 26.03 and later). Temperatures are primvars.

Source: https://openusd.org/release/user_guides/schemas/usdVol/ParticleField.html
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rtgs.base.errors import RtgsError
from rtgs.base.files import write_whole
from rtgs.io.exports.frames import FileFrame
from rtgs.io.exports.subject import Splats


def check_usd() -> None:
    """Raises `RtgsError` where the library is missing or too old."""
    try:
        from pxr import UsdVol
    except ImportError as error:
        raise RtgsError("--format usd needs the library usd-core: pip install 'rtgs[usd]'.") from error
    if not hasattr(UsdVol, "ParticleField3DGaussianSplat"):
        raise RtgsError("--format usd needs usd-core 26.3 or later: pip install --upgrade usd-core.")


def write_usd(path: Path, splats: Splats, frame: FileFrame) -> None:
    """Write a model as the default prim of a stage; `path` appears whole or not at all."""
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdVol, Vt

    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if frame.axes == "z-up" else UsdGeom.Tokens.y)
    if frame.per_metre is not None:
        UsdGeom.SetStageMetersPerUnit(stage, 1.0 / frame.per_metre)
    prim = UsdVol.ParticleField3DGaussianSplat.Define(stage, f"/{path.stem}")
    stage.SetDefaultPrim(prim.GetPrim())
    means, sizes = splats.means.astype(np.float32), np.exp(splats.log_scales)
    prim.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(means))
    prim.CreateScalesAttr(Vt.Vec3fArray.FromNumpy(sizes))
    prim.CreateOpacitiesAttr(Vt.FloatArray.FromNumpy(splats.opacities.astype(np.float32)))
    prim.CreateOrientationsAttr(Vt.QuatfArray([Gf.Quatf(*q) for q in splats.quats.tolist()]))
    prim.CreateRadianceSphericalHarmonicsDegreeAttr(splats.sh_degree)
    prim.CreateRadianceSphericalHarmonicsCoefficientsAttr(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(splats.sh.reshape(-1, 3))))
    reach = 3.0 * sizes.max(axis=1, keepdims=True)
    corners = np.stack([(means - reach).min(axis=0), (means + reach).max(axis=0)]).astype(np.float32)
    prim.CreateExtentAttr(Vt.Vec3fArray.FromNumpy(corners))
    primvars = UsdGeom.PrimvarsAPI(prim)
    for name, column in splats.columns.items():
        variable = primvars.CreatePrimvar(name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex)
        variable.Set(Vt.FloatArray.FromNumpy(np.ascontiguousarray(column)))
    if splats.legend is not None:
        prim.GetPrim().SetCustomDataByKey("temperatureUnit", splats.unit)
    with write_whole(path) as temporary:
        named = temporary.with_name(temporary.name + path.suffix)  # the library knows the format by the name
        stage.GetRootLayer().Export(str(named))
        named.replace(temporary)
