"""Write devices, streams, assets and errors as XML documents of MTConnect 2.4."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby

from lxml import etree

from cnc_interp.core import MM
from cnc_interp.mtconnect.device import CONDITION, Component, DataItem, items_of, name_of
from cnc_interp.mtconnect.store import (
    FAULT,
    WARNING,
    Observation,
    RequestError,
    Store,
)
from cnc_interp.program.job import Tool

VERSION, ASSETS_KEPT = '2.4', 1024
SPACE = 'urn:mtconnect.org:MTConnect{kind}:2.4'
SCHEMA = 'http://schemas.mtconnect.org/schemas/MTConnect{kind}_2.4.xsd'
XSI = 'http://www.w3.org/2001/XMLSchema-instance'
BASE_FRAME = 'machine_frame'
CATEGORIES = {'SAMPLE': 'Samples', 'EVENT': 'Events', CONDITION: 'Condition'}
MOTIONS = {'prismatic': 'PRISMATIC', 'revolute': 'REVOLUTE', 'continuous': 'CONTINUOUS'}
STRANGE = re.compile('[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]')
LONGEST_PATH = 1000  #: Longest XPath in a request [characters].


def instant(time: float) -> str:
    """Return a time, given in seconds since 1970, as MTConnect text with microseconds."""
    return datetime.fromtimestamp(time, UTC).strftime('%Y-%m-%dT%H:%M:%S.%fZ')


def asset_id(machine: str, number: int) -> str:
    return f'{name_of(machine)}_tool_{number}'


def _triple(values: Iterable[float]) -> str:
    return ' '.join(f'{value:.9g}' for value in values)


@dataclass(frozen=True)
class Agent:
    """Makes the documents of one device; ``instance``: identifies this start of the agent."""

    device: Component
    store: Store
    host: str
    instance: int

    def _document(self, kind: str, **header: int) -> etree._Element:
        space = SPACE.format(kind=kind)
        root = etree.Element(
            f'{{{space}}}MTConnect{kind}',
            {f'{{{XSI}}}schemaLocation': f'{space} {SCHEMA.format(kind=kind)}'},
            nsmap={None: space, 'xsi': XSI},
        )
        now = instant(self.store.clock())
        told = {'creationTime': now, 'sender': self.host, 'instanceId': self.instance}
        told |= {'version': VERSION, 'bufferSize': self.store.size, **header}
        if kind != 'Error':
            told['deviceModelChangeTime'] = instant(self.instance)
        if kind == 'Assets':
            del told['bufferSize']
        etree.SubElement(root, f'{{{space}}}Header', {k: str(v) for k, v in told.items()})
        return root

    def devices(self, tools: int) -> bytes:
        """Return the document that describes the device; ``tools``: number of its tool assets."""
        root = self._document('Devices', assetBufferSize=ASSETS_KEPT, assetCount=tools)
        _component(_sub(root, 'Devices'), self.device)
        return _text(root)

    def chosen(self, path: str) -> Collection[str]:
        """Return the ids of the data items that an XPath selects; RequestError if invalid."""
        whole = items_of(self.device)
        if not path:
            return whole
        if len(path) > LONGEST_PATH:
            raise RequestError('INVALID_PATH', 'path is too long')
        root = etree.Element('MTConnectDevices')
        _component(_sub(root, 'Devices'), self.device)
        try:
            found = root.xpath(path)
        except (etree.XPathError, ValueError) as problem:
            raise RequestError('INVALID_PATH', f'path: {problem}') from None
        if not isinstance(found, list):
            raise RequestError('INVALID_PATH', 'path names no elements')
        elements = [one for one in found if isinstance(one, etree._Element)]
        return {item.get('id') for one in elements for item in one.iter('DataItem')}

    def streams(self, found: Iterable[Observation], following: int) -> bytes:
        """Return a document of observations; ``following``: number where the next one begins."""
        store = self.store
        last = store.next_sequence - 1
        first = min(store.first_sequence, last)
        root = self._document(
            'Streams', nextSequence=following, firstSequence=first, lastSequence=last
        )
        stream = _sub(
            _sub(root, 'Streams'), 'DeviceStream', name=self.device.name, uuid=self.device.uuid
        )
        by_item: dict[str, list[Observation]] = {}
        for one in found:
            by_item.setdefault(one.item, []).append(one)
        for part in self.device.walk():
            told = [item for item in part.items if item.id in by_item]
            if not told:
                continue
            name = {'name': part.name} if part.name else {}
            place = _sub(
                stream, 'ComponentStream', component=part.kind, componentId=part.id, **name
            )
            order = list(CATEGORIES)
            told.sort(key=lambda item: order.index(item.category))
            for category, items in groupby(told, key=lambda item: item.category):
                group = _sub(place, CATEGORIES[category])
                for item in items:
                    for one in by_item[item.id]:
                        _observation(group, item, one)
        return _text(root)

    def assets(self, tools: dict[int, Tool]) -> bytes:
        """Return a document with an asset for each tool; ``tools``: by tool number."""
        root = self._document('Assets', assetBufferSize=ASSETS_KEPT, assetCount=len(tools))
        place = _sub(root, 'Assets')
        for number, tool in tools.items():
            asset = _sub(
                place,
                'CuttingTool',
                assetId=asset_id(self.device.name, number),
                serialNumber=str(number),
                toolId=str(number),
                timestamp=instant(self.instance),
                deviceUuid=self.device.uuid,
            )
            if tool.remark:
                _sub(asset, 'Description').text = sound(tool.remark)
            life = _sub(asset, 'CuttingToolLifeCycle')
            _sub(_sub(life, 'CutterStatus'), 'Status').text = 'AVAILABLE'
            _sub(life, 'ProgramToolNumber').text = str(number)
            if tool.pocket:
                _sub(life, 'Location', type='POT').text = str(tool.pocket)
            measured = _sub(life, 'Measurements')
            sizes = (
                ('FunctionalLength', 'LF', tool.worn.length),
                ('CuttingDiameterMax', 'DC', 2.0 * tool.worn.radius),
            )
            for name, code, size in sizes:
                size_of = _sub(measured, name, code=code, units='MILLIMETER')
                size_of.text = f'{size / MM:.4f}'
        return _text(root)

    def error(self, problem: RequestError) -> bytes:
        root = self._document('Error')
        _sub(_sub(root, 'Errors'), 'Error', errorCode=problem.code).text = sound(str(problem))
        return _text(root)


def sound(text: str) -> str:
    """Return a text without characters that are not allowed in XML."""
    return STRANGE.sub('\ufffd', text)


def _text(root: etree._Element) -> bytes:
    return bytes(etree.tostring(root, xml_declaration=True, encoding='UTF-8'))


def _sub(parent: etree._Element, name: str, /, **attributes: str) -> etree._Element:
    """Append an XML element with the namespace of its parent; return it."""
    space = etree.QName(parent).namespace
    return etree.SubElement(parent, f'{{{space}}}{name}' if space else name, attributes)


def _component(place: etree._Element, part: Component) -> None:
    told = {'id': part.id}
    if part.name:
        told['name'] = part.name
    if part.uuid:
        told['uuid'] = part.uuid
    element = _sub(place, part.kind, **told)
    if part.uuid:
        frames = _sub(_sub(element, 'Configuration'), 'CoordinateSystems')
        _sub(frames, 'CoordinateSystem', id=BASE_FRAME, type='MACHINE')
    if part.joint is not None:
        joint = part.joint
        carrier = {'parentIdRef': f'axis_{part.carrier}_motion'} if part.carrier else {}
        motion = _sub(
            _sub(element, 'Configuration'),
            'Motion',
            id=f'{part.id}_motion',
            type={'prismatic': 'PRISMATIC', 'continuous': 'CONTINUOUS'}.get(
                joint.kind, 'REVOLUTE'
            ),
            actuation='DIRECT',
            coordinateSystemIdRef=BASE_FRAME,
            **carrier,
        )
        _sub(motion, 'Origin').text = _triple(value / MM for value in joint.origin)
        _sub(motion, 'Axis').text = _triple(joint.along)
    if part.items:
        items = _sub(element, 'DataItems')
        for item in part.items:
            more = {'subType': item.sub_type, 'units': item.units}
            given = {name: value for name, value in more.items() if value}
            _sub(items, 'DataItem', id=item.id, type=item.type, category=item.category, **given)
    if part.parts:
        below = _sub(element, 'Components')
        for one in part.parts:
            _component(below, one)


def _observation(place: etree._Element, item: DataItem, one: Observation) -> None:
    told = {'dataItemId': item.id, 'sequence': str(one.sequence), 'timestamp': instant(one.time)}
    if item.category == CONDITION:
        known = one.value.capitalize()
        element = _sub(place, known, type=item.type, **told)
        if one.value in (WARNING, FAULT):
            element.text = sound(one.text)
            element.set('conditionId', one.code)
        if one.code:
            element.set('nativeCode', one.code)
        return
    if item.sub_type:
        told['subType'] = item.sub_type
    if item.type.startswith('ASSET_'):
        told['assetType'] = 'CuttingTool'
    _sub(place, item.element, **told).text = sound(one.value)
