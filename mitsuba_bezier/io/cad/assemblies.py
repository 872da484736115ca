"""Read the structure of STEP and IGES files through OpenCASCADE's XCAF: names, colours, places.

An assembly is a tree of products. Each product that is no assembly is one part, converted once; all
its occurrences are placements of that part. Colours are those of faces, else of the occurrence,
else of the product. Free faces of an IGES file are one part a level.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..parts import Colour

__all__ = ["Product", "products", "step_unit"]

#: Assemblies within each other, and occurrences in all.
_MAX_DEPTH, _MAX_PLACES = 64, 1_000_000
#: Names that OpenCASCADE makes up where a file has none.
_MADE_UP = re.compile(
    r"|=>\[[\d:]+\]|COMPOUND|COMPSOLID|SOLID|SHELL|FACE|WIRE|EDGE|VERTEX|SHAPE|NONE|Open CASCADE.*"
    r"|(?:STEP|IGES)? ?Root \d+",
    re.IGNORECASE,
)


@dataclass
class Product:
    """What becomes a part.

    Attributes
    ----------
    shapes : list of TopoDS_Shape
        What it is made of, in its own coordinates.
    name, layer : str
    colour : colour or None
    placements : list of (4, 4) arrays
    places : list of str
    visible : bool
    """

    shapes: list[Any]
    name: str
    colour: Colour | None = None
    layer: str = ""
    visible: bool = True
    placements: list[np.ndarray] = field(default_factory=list)
    places: list[str] = field(default_factory=list)


def _labels() -> Any:
    """Return an empty list of labels: its class has moved between 7.9 and 8."""
    try:
        from OCP import TDF

        return TDF.TDF_LabelSequence()
    except AttributeError:
        from OCP.OCP.collections import Sequence_TDF_Label

        return Sequence_TDF_Label()


def _listed(labels: Any) -> list[Any]:
    return [labels.Value(k + 1) for k in range(labels.Length())]


class Document:
    """A file as XCAF reads it.

    Parameters
    ----------
    path : Path
        The file.
    iges : bool
        Whether it is an IGES file.
    settle : callable
        Changes settings of readers.

    Attributes
    ----------
    done : bool
        Whether it could be read.
    """

    def __init__(self, path: Path, iges: bool, settle: Callable[[], None]) -> None:
        from OCP import (
            IFSelect,
            IGESCAFControl,
            STEPCAFControl,
            TCollection,
            TDocStd,
            XCAFApp,
            XCAFDoc,
        )

        self.xcaf = XCAFDoc
        text = TCollection.TCollection_ExtendedString
        self.document = TDocStd.TDocStd_Document(text("MDTV-XCAF"))
        application = XCAFApp.XCAFApp_Application.GetApplication_s()
        application.NewDocument(text("MDTV-XCAF"), self.document)
        kind = (
            IGESCAFControl.IGESCAFControl_Reader if iges else STEPCAFControl.STEPCAFControl_Reader
        )
        self.reader = kind()
        settle()  # the reader has defined the settings
        for mode in ("SetColorMode", "SetNameMode", "SetLayerMode"):
            getattr(self.reader, mode)(True)
        # what takes time and is not asked for; a reader of IGES files does not know them all
        for mode in ("SetGDTMode", "SetMatMode", "SetMetaMode", "SetPropsMode", "SetViewMode"):
            if hasattr(self.reader, mode):
                getattr(self.reader, mode)(False)
        self.done = self.reader.ReadFile(str(path)) == IFSelect.IFSelect_RetDone

    def transfer(self) -> None:
        """Convert what was read."""
        self.reader.Transfer(self.document)
        tool = self.xcaf.XCAFDoc_DocumentTool
        main = self.document.Main()
        self.shapes, self.colours = tool.ShapeTool_s(main), tool.ColorTool_s(main)
        self.layers = tool.LayerTool_s(main)

    def free(self) -> list[Any]:
        """Return the labels of what no assembly refers to."""
        labels = _labels()
        self.shapes.GetFreeShapes(labels)
        return _listed(labels)

    def components(self, label: Any) -> list[Any]:
        """Return the labels of what an assembly is made of."""
        labels = _labels()
        self.shapes.GetComponents_s(label, labels, False)
        return _listed(labels)

    def referred(self, label: Any) -> Any:
        """Return the product that a label stands for."""
        from OCP import TDF

        if not self.shapes.IsReference_s(label):
            return label
        out = TDF.TDF_Label()
        self.shapes.GetReferredShape_s(label, out)
        return out

    def name(self, label: Any) -> str:
        """Return the name of a label, empty if it has none of its own."""
        from OCP import TDataStd

        key = TDataStd.TDataStd_Name.GetID_s()
        if not label.IsAttribute(key):
            return ""
        attribute = TDataStd.TDataStd_Name()
        if not label.FindAttribute(key, attribute):
            return ""
        text = str(attribute.Get().ToExtString()).strip()
        text = "".join(c if c.isprintable() else " " for c in text).strip().replace("/", "-")
        return "" if _MADE_UP.fullmatch(text) else text

    def key(self, label: Any) -> str:
        """Return what tells a label from all others."""
        tags = []
        while not label.IsRoot():
            tags.append(str(label.Tag()))
            label = label.Father()
        return ":".join(tags)

    def colour(self, label: Any) -> Colour | None:
        """Return the colour of the surface of a label."""
        from OCP import Quantity

        found = Quantity.Quantity_Color()
        for kind in (self.xcaf.XCAFDoc_ColorSurf, self.xcaf.XCAFDoc_ColorGen):
            if self.colours.GetColor_s(label, kind, found):
                return found.Red(), found.Green(), found.Blue()
        return None

    def face_colour(self, shape: Any) -> Colour | None:
        """Return the colour of a face, solid or shell itself."""
        from OCP import Quantity

        found = Quantity.Quantity_Color()
        for kind in (self.xcaf.XCAFDoc_ColorSurf, self.xcaf.XCAFDoc_ColorGen):
            if self.colours.GetColor(shape, kind, found):
                return found.Red(), found.Green(), found.Blue()
        return None

    def layer(self, label: Any) -> str:
        """Return the first layer of a label."""
        found = self.layers.GetLayers(label)
        if found is None or found.Length() == 0:
            return ""
        return str(found.Value(1).ToExtString()).strip()

    def visible(self, label: Any) -> bool:
        """Return whether a label is shown."""
        return bool(self.colours.IsVisible_s(label))

    def matrix(self, label: Any) -> np.ndarray:
        """Return the placement ``(4, 4)`` of a label in its assembly."""
        location = self.shapes.GetLocation_s(label)
        out = np.eye(4)
        if not location.IsIdentity():
            moved = location.Transformation()
            out[:3] = [[moved.Value(i + 1, j + 1) for j in range(4)] for i in range(3)]
        return out


def products(document: Document, stem: str) -> list[Product]:
    """Return the products of a file with the places where they stand.

    Parameters
    ----------
    document : Document
        After `Document.transfer`.
    stem : str
        Name of parts whose file tells none.
    """
    from OCP import TopAbs

    found: dict[Any, Product] = {}
    count = 0

    def walk(
        label: Any, matrix: np.ndarray, path: tuple[str, ...], depth: int, shown: bool
    ) -> None:
        nonlocal count
        target = document.referred(label)
        matrix = matrix @ document.matrix(label)
        shown = shown and document.visible(label) and document.visible(target)
        own = document.name(target)
        here = document.name(label) or own
        if document.shapes.IsAssembly_s(target):
            if depth < _MAX_DEPTH:
                inner = (*path, here) if here else path
                for component in document.components(target):
                    walk(component, matrix, inner, depth + 1, shown)
            return
        count += 1
        if count > _MAX_PLACES:
            return
        shape = document.shapes.GetShape_s(target)
        colour = document.colour(label) if target is not label else None
        colour = document.colour(target) if colour is None else colour
        layer = document.layer(label) or document.layer(target)
        name = own or here or (path[-1] if path else stem)
        if shape.ShapeType() == TopAbs.TopAbs_ShapeEnum.TopAbs_FACE and not path:
            key: Any = ("faces", layer, shown)
            product = found.setdefault(key, Product([], "", None, layer, shown, [np.eye(4)], []))
            product.shapes.append(shape)
            return
        key = (document.key(target), colour, shown)
        product = found.setdefault(key, Product([shape], name, colour, layer, shown))
        product.placements.append(matrix)
        product.places.append("/".join((*path, here or name)))

    for label in document.free():
        walk(label, np.eye(4), (), 0, True)
    return list(_named(found, stem))


def _named(found: dict[Any, Product], stem: str) -> Iterator[Product]:
    """Give parts names that no two of them have."""
    levels = sum(key[0] == "faces" for key in found)
    taken: dict[str, int] = {}
    for product in found.values():
        if not product.name:
            product.name = f"level {product.layer}" if levels > 1 and product.layer else stem
        taken[product.name] = taken.get(product.name, 0) + 1
        if taken[product.name] > 1:
            product.name = f"{product.name}.{taken[product.name]}"
        if len(product.places) != len(product.placements):
            product.places = [product.name] * len(product.placements)
        yield product


def step_unit(reader: Any, iges: bool) -> str:
    """Return the unit of the lengths in a file, such as ``inch``; empty if it does not tell."""
    try:
        if iges:
            return str(reader.IGESModel().GlobalSection().UnitName().ToCString()).strip().lower()
        try:
            from OCP.OCP.collections import Sequence_TCollection_AsciiString as Names
        except ImportError:
            from OCP.TColStd import TColStd_SequenceOfAsciiString as Names
        names = [Names() for _ in range(3)]
        reader.Reader().FileUnits(*names)
        return str(names[0].Value(1).ToCString()).strip().lower() if names[0].Length() else ""
    except Exception:  # a file without units is none that cannot be read
        return ""
