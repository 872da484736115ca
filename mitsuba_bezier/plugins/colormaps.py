"""Colour maps: tables of 256 colours by the names that matplotlib has for them.

The maps here are those of matplotlib to the byte: viridis, plasma, inferno, magma (CC0), cividis
(public domain), and coolwarm of K. Moreland, "Diverging Color Maps for Scientific Visualization",
2009. All others come from matplotlib itself, if it is installed.
"""

from __future__ import annotations

import base64
import zlib
from difflib import get_close_matches
from functools import cache

import numpy as np

from ..errors import BezierError

__all__ = ["banded", "color_table", "linear_rgb"]

#: Differences of the bytes, compressed: 256 of red, of green, of blue.
_TABLES = {
    "viridis": (
        "c-n<hi4lY#3{0@KE8+St<xsL4Sjp&Rzu+jyOg`opECkc)X`Q6qnhK3HNo_OG;RhV>kb4UegZDb1pdhW1hA(9608i"
        "7%o<`5u+O6#W6MI|R-q~_nLKyo3Fq1@l=e3($blyl0DjP1z=#&|HsQxfvb9OjPgHv1mpkyG8q{bp%?-(;)vb7T{k"
        "BAB"
    ),
    "plasma": (
        "c-nnZ(Gq|l2qSyxrSI;mJ2C|}$P4BM#ifDg-mSHcVVl!tfQC>Ip2!euQVL*FB1t3_0_pB#FoG&XUyx78p<ZRRMYV"
        "p1H;99feg3sA)Bo4RL9{ZMiYEd{uGmd51vLB9=;&~m0@2nNV?h=Pr?S>RSw0n~IbOAM`Rx3X4DD6-1AJtl3j"
    ),
    "inferno": (
        "c-nnYff9uv2!rhX{~u?`HW6PJ%pqLTG0e>d{DJHs!U>Qs;e$R4<q|F;;(*eOB!nkOv@Yrca*^RRewRH^w6*urP6u"
        "^geWN|pynv!x9d(YM%G6!t7O)v|#%cbNLw)LdoUU&gNobki>0F5>sw(}<pOS}zaOtF1yLP_vOejQK(?U6N(<p5Kb"
        "`Gcg5T42nM;>jU"
    ),
    "magma": (
        "c-nnZ0TRO?2ov1@zwB-SL$G!b1Lv7mfnj3+W>_$1*l-6$vculB^q1sG_f&LnT*IwwB;bXl<Uh79*?xVvf`0)m>K0"
        "|9YP!<*pnj$WHo~<BT6(W=N!o!IuJjWh_vy5m1SCzK_+2Be79*q0Xg#o_&`SykB*7c7NQn@fO{<x$$z{pxF?9O+h"
        "+oRdEx7"
    ),
    "cividis": (
        "c-oCp0TO^92m|ybJ*fY`MiW5;#j7#KtPU>}AOz-=Qz8LMC~@csu(_o|`0~&r2K{(Un<G<L+K*nk893UNFaH;(4yG"
        ")2%Y)gipR5@le9V+?<nv{!@JY7;K<)RSPEmbpcx}8vCz^w}e(oDD`<v{vGDFy8rih@Z6b?ok2t7^bLmv"
    ),
    "coolwarm": (
        "c-noD*%8Aa3`D_grG*rozG9F;2a*=XXb+EntY<!To-0ML7wg#g616O`>TrsfRZ8V4@(71m!z3|A#rC4^CGHY3-)k"
        "(syh+2VhDvxFRM~KR3~DC9_OLvz-x0uKiY*bkc@4KFy8kji<pVC@$ut2&Dbl@|5iL?tq=G9ks_^huhe;7`UjJqfp"
        "ML-#{!;D"
    ),
}


@cache
def color_table(name: str) -> np.ndarray:
    """Return the colours of a map, sRGB from 0 to 1, ``(256, 3)``.

    Parameters
    ----------
    name : str
        ``viridis``, ``plasma``, ``inferno``, ``magma``, ``cividis``, ``coolwarm`` or ``gray``, or
        any of matplotlib's; with ``_r`` at its end, turned.

    Raises
    ------
    BezierError
        If there is none of this name.
    """
    plain = name.removesuffix("_r")
    if plain in ("gray", "grey"):
        table = np.repeat(np.linspace(0, 1, 256)[:, None], 3, axis=1)
    elif plain in _TABLES:
        data = zlib.decompress(base64.b85decode(_TABLES[plain]))
        steps = np.frombuffer(data, dtype=np.uint8).reshape(3, 256).T
        table = np.cumsum(steps, axis=0, dtype=np.uint8) / 255.0
    else:
        return _of_matplotlib(name)
    table = np.ascontiguousarray(table[::-1] if plain != name else table)
    table.setflags(write=False)
    return table


def _of_matplotlib(name: str) -> np.ndarray:
    own = [*_TABLES, "gray"]
    try:
        from matplotlib import colormaps
    except ImportError:
        expected = f"{', '.join(own)}, or matplotlib's after pip install 'mitsuba-bezier[plot]'"
        raise BezierError.expected("colormap", expected, repr(name)) from None
    if name not in colormaps:
        near = get_close_matches(name.lower(), list(colormaps), n=5, cutoff=0.5) or own
        expected = f"{', '.join(near)}, or another of matplotlib's"
        raise BezierError.expected("colormap", expected, repr(name))
    table = np.asarray(colormaps[name](np.linspace(0, 1, 256)))[:, :3].astype(np.float64)
    table.setflags(write=False)
    return table


def banded(name: str, levels: int) -> np.ndarray:
    """Return the colours of `levels` bands, of equal distances in a map, ``(levels, 3)``."""
    table = color_table(name)
    at = (np.arange(levels) + 0.5) / levels * 255
    low = np.floor(at).astype(int)
    share = (at - low)[:, None]
    return (1 - share) * table[low] + share * table[np.minimum(low + 1, 255)]


def linear_rgb(srgb: np.ndarray) -> np.ndarray:
    """Return linear RGB of sRGB."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
