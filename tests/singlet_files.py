"""One biconvex lens of N-BK7, as the lens files of two programs; the texts of tests of the import and of others."""

from pathlib import Path

DATA = Path(__file__).parent / "data"
ZMX, SEQ = ((DATA / f"singlet.{kind}").read_text(encoding="utf-8") for kind in ("zmx", "seq"))


def plano_convex(glass: str, catalogues: str, um: float) -> str:
    """The Zemax file with a plane rear, of another glass, for light of another wavelength."""
    text = ZMX.replace("N-BK7 0 0 1.5168 64.17", glass).replace("GCAT SCHOTT", f"GCAT {catalogues}")
    return text.replace("0.5875618", str(um)).replace("CURV -0.02", "CURV 0")
