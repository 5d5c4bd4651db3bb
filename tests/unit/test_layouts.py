"""Layouts for others' tools: of the form that those tools write and read.

Foxglove's is held against the classes of its SDK; PlotJuggler's and RViz' against what their sources read (plot_docker
and plotwidget of PlotJuggler 3; displays and properties of RViz for Jazzy): neither has a wheel.
"""

import dataclasses
import json
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml

from valor.common.resources import example_file

_ATTRIBUTES = {
    "root": set(), "tabbed_widget": {"name", "parent"}, "Tab": {"tab_name", "containers"}, "Container": set(),
    "DockSplitter": {"orientation", "count", "sizes"}, "DockArea": {"name"},
    "plot": {"mode", "style", "flip_x", "flip_y"}, "limitY": set(), "curve": {"name", "color", "curve_x", "curve_y"},
    "currentTabIndex": {"index"}, "use_relative_time_offset": {"enabled"},
}  # fmt: skip
_TOPIC = {"Value", "Depth", "History Policy", "Reliability Policy", "Durability Policy"}
_DISPLAY = {"Class", "Name", "Enabled", "Value"}
_PROPERTIES = {
    "Grid": {"Reference Frame", "Plane Cell Count", "Cell Size"},
    "RobotModel": {"Description Source", "Description Topic", "Visual Enabled", "Collision Enabled"},
    "TF": {"Show Names", "Marker Scale"},
    "Wrench": {"Topic", "Force Color", "Force Arrow Scale", "Torque Arrow Scale", "Arrow Width"},
    "PointStamped": {"Topic", "Color", "Radius"},
    "Odometry": {"Topic", "Keep", "Position Tolerance"},
    "PointCloud2": {"Topic", "Style", "Size (Pixels)", "Color Transformer", "Axis"},
    "Image": {"Topic", "Normalize Range", "Min Value", "Max Value"},
    "LaserScan": {"Topic", "Style", "Size (Pixels)", "Color Transformer", "Color"},
}


def test_foxgloves_has_panels_and_settings_that_its_sdk_has() -> None:
    pytest.importorskip("foxglove", reason="the extra foxglove is not installed")
    import foxglove.layouts as known

    panels, kinds = {}, list[Any](known.BasePanel.__subclasses__())
    for kind in kinds:
        if {each.name for each in dataclasses.fields(kind)} == {"config", "title"} and (made := kind()).config:
            panels[json.loads(made.to_json())["panelType"]] = set(made.config._to_dict())
    layout = json.loads(example_file("layouts/foxglove.json").read_text())
    assert set(layout) <= set(known.Layout(content=known.PlotPanel())._to_dict())
    found = list(_panels(layout["content"]))
    assert len(found) >= 8
    for panel in found:
        assert set(panel["config"]) <= panels[panel["panelType"]], panel["title"]
        for path in panel["config"].get("paths", []):
            series = known.PlotSeries if panel["panelType"] == "Plot" else known.StateTransitionsSeries
            assert set(path) <= set(series()._to_dict())


def _panels(content: dict[str, Any]) -> list[dict[str, Any]]:
    if content["type"] == "panel":
        return [content]
    parts = content["items"] if content["type"] == "split" else content["tabs"]
    return [panel for part in parts for panel in _panels(part["content"])]


def test_plotjugglers_has_elements_and_attributes_that_it_reads() -> None:
    root = ElementTree.parse(example_file("layouts/plotjuggler.xml")).getroot()
    for element in root.iter():
        assert set(element.attrib) <= _ATTRIBUTES[element.tag], element.tag
    for splitter in root.iter("DockSplitter"):
        shares = [float(each) for each in splitter.attrib["sizes"].split(";")]
        assert len(splitter) == len(shares) == int(splitter.attrib["count"]) and sum(shares) == pytest.approx(1.0)
    for plot in root.iter("plot"):
        both = {"curve_x", "curve_y"} if plot.attrib["mode"] == "XYPlot" else set()
        for curve in plot.iter("curve"):
            assert set(curve.attrib) == {"name", "color"} | both


def test_rviz_configuration_has_displays_and_properties_that_it_has() -> None:
    configuration = yaml.safe_load(example_file("layouts/valor.rviz").read_text())
    manager = configuration["Visualization Manager"]
    for display in manager["Displays"]:
        package, kind = display["Class"].split("/")
        assert package == "rviz_default_plugins" and set(display) <= _DISPLAY | _PROPERTIES[kind]
        for name in {"Topic", "Description Topic"} & set(display):
            assert set(display[name]) == _TOPIC
    assert set(manager["Global Options"]) == {"Background Color", "Fixed Frame", "Frame Rate"}
