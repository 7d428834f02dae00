"""Tool tables of other programs, and what a tool measures with its wear."""

import pytest

from cnc_interp.core import InterpError
from cnc_interp.program.job import JobSetup, Tool
from cnc_interp.program.tool_files import csv_text, tbl_text, tools_of_text

#: As LinuxCNC keeps it: a lathe's words, comments, several spaces, no blank between words.
TBL = """; my tools
T1 P7 D6.000000 Z+75.250000 ;end mill; 3 flutes
T2  P2 X0 Y0 Z-12.5 A0 B0 C0 U0 V0 W0 D.5 I0 J0 Q0

T99999 P12 Z+.5
"""


def test_a_table_of_linuxcnc_is_read_in_its_unit():
    tools = tools_of_text(TBL, 1e-3)
    assert tools[1] == Tool(0.07525, 0.003, 'end mill; 3 flutes', pocket=7)
    assert tools[2] == Tool(-0.0125, 0.00025, pocket=2)
    assert tools[99999] == Tool(0.0005, pocket=12)
    assert tools_of_text(TBL, 0.0254)[1].length == pytest.approx(75.25 * 0.0254)


@pytest.mark.parametrize('mark', [',', ';', '\t'])
def test_csv_of_a_spreadsheet_is_read_with_its_decimal_mark(mark):
    comma = '.' if mark == ',' else ','
    rows = ['Number,Diameter,Length,Remark', '3,6.5,80.25,"ball, worn"', '', '4,,12,']
    if mark != ',':
        rows = ['Number|Diameter|Length|Remark', '3|6.5|80.25|ball, worn', '', '4||12|']
        rows = [row.replace('|', mark).replace('.', comma) for row in rows]
    tools = tools_of_text('\ufeff' + '\r\n'.join(rows), 1e-3)
    assert tools == {3: Tool(0.08025, 0.5 * 6.5 * 1e-3, 'ball, worn'), 4: Tool(0.012)}


def test_what_is_written_is_read_again_alike():
    tools = {
        5: Tool(0.0751234, 0.004, 'ball "R4", new', 0.004, -0.0001, 0.0002, 3, 'slim', 0.012),
        7: Tool(-0.02),
    }
    again = tools_of_text(csv_text(tools, 1e-3), 1e-3)
    assert again.keys() == tools.keys()
    for number, tool in tools.items():
        assert vars(again[number]) == pytest.approx(vars(tool), abs=1e-9)
    again = tools_of_text(tbl_text(tools, 1e-3), 1e-3)
    assert again[5].length == pytest.approx(0.0750234) and again[5].radius == pytest.approx(0.0042)
    assert (again[5].remark, again[5].pocket) == ('ball "R4", new', 3)


@pytest.mark.parametrize(
    ('text', 'told'),
    [
        ('', 'no tools'),
        ('hello', 'columns are'),
        ('T1 P1 Z1\nT1 P2 Z2', 'line 2: tool 1: the tool is in the file twice'),
        ('T1 P1 Z1\nP2 Z2', "line 2: 'T'"),
        ('T1 P1 Z1 K3', "line 1: 'K'"),
        ('T1 P1 Z1 hello', 'line 1: '),
        ('T1 P1 D-3', 'line 1: tool 1: the radius'),
        ('T0 P1 Z1', 'line 1: tool 0'),
        ('number,length\n1,long', 'line 2: '),
        ('number,flutes\n1,3', "see 'flutes'"),
        ('number,length,radius,corner_radius,flute\n1,9,3,3,5', 'line 2: tool 1: the flute'),
        ('number,length,remark\n1,1,' + 'a' * 200, 'line 2: tool 1: the remark'),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(text, told):
    with pytest.raises(InterpError, match=told.replace('(', r'\(')):
        tools_of_text(text, 1e-3)


def test_a_setup_file_keeps_wear_and_pocket():
    setup = JobSetup(tools={3: Tool(0.08, 0.005, 'x', 0.005, -1e-5, 2e-5, 12)})
    assert JobSetup.of_text(setup.text()) == setup
    assert setup.tools[3].worn == Tool(0.08 - 1e-5, 0.005 + 2e-5, 'x', 0.005 + 2e-5)
