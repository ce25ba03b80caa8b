"""One biconvex lens of N-BK7, as the lens files of two programs; the texts of tests of the import and of others."""

from __future__ import annotations

# f = 50 · 50 / 100 / (n - 1) about, n of N-BK7 at the d line
ZMX = """MODE SEQ
NAME Singlet
UNIT MM X W X CM MR CPMM
ENPD 8
GCAT SCHOTT
FTYP 0 0 2 1 0 0 0
XFLN 0 0
YFLN 0 3
WAVM 1 0.5875618 1
PWAV 1
XYZZY 1 2 3
SURF 0
  TYPE STANDARD
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17
SURF 2
  TYPE STANDARD
  CURV -0.02
  DISZ 46
SURF 3
  TYPE STANDARD
  DISZ 0
"""
SEQ = """RDM Y
LEN
TITLE 'Singlet'
EPD 8
DIM M
WL 587.5618
REF 1
XAN 0 0
YAN 0 3
SO 0 1E20
S 50 5 NBK7_SCHOTT
  STO
S -50 46
SI 0 0
GO
"""


def plano_convex(glass: str, catalogues: str, um: float) -> str:
    """The Zemax file with a plane rear, of another glass, for light of another wavelength."""
    text = ZMX.replace("N-BK7 0 0 1.5168 64.17", glass).replace("GCAT SCHOTT", f"GCAT {catalogues}")
    return text.replace("0.5875618", str(um)).replace("CURV -0.02", "CURV 0")
