"""Loops, jumps, subprograms, expressions and canned cycles, against lines that do the same."""

import numpy as np
import pytest
from test_program_gcode import ThreeAxes

from cnc_interp.core import ProgramError
from cnc_interp.program import open_program, read_program, read_text
from cnc_interp.settings.options import Settings


def read(text, **options):
    return read_text(text, 'part.ngc', ThreeAxes(), Settings(**options))


def xs(text, **options):
    if any(word in text for word in ('R2=', 'R1<>', 'DEF ', 'CASE ', 'GOTOC')):
        text, options = text.replace('#1=1', 'R1=1'), {'dialect': 'siemens', **options}
    return (read(text, **options).blocks.tip[:, 0] * 1e3).round(9).tolist()


@pytest.mark.parametrize(
    ('expression', 'value'),
    [
        ('[1 + 2 * 3]', 7),
        ('[[1 + 2] * 3]', 9),
        ('[2 ** 3 - 1]', 7),
        ('[7 MOD 4]', 3),
        ('[-3]', -3),
        ('[SIN[30]]', 0.5),
        ('[COS[60] * 2]', 1),
        ('[ATAN[1]/[1]]', 45),
        ('[SQRT[16]]', 4),
        ('[ABS[-2]]', 2),
        ('[FIX[-2.5]]', -3),
        ('[FUP[2.1]]', 3),
        ('[ROUND[2.5]]', 3),
        ('[LN[EXP[2]]]', 2),
        ('[1 EQ 1]', 1),
        ('[2 GT 3 OR 1 LT 2]', 1),
        ('[1 AND 0]', 0),
        ('[ACOS[0]]', 90),
        ('#1', 5),
        ('-#1', -5),
        ('##2', 5),
        ('[#1+#2]', 6),
        ('#[#2 * 1]', 5),
        ('#<depth>', 8),
        ('=A_B+1', 10),
        ('=R5*2', 14),
        ('=POT(3)', 9),
        ('=-(1+R5)/2', -4),
        ('=SIN(90)', 1),
        ('=ATAN2(1,1)', 45),
        ('=9 DIV R5', 1),
        ('=9 MOD R5', 2),
        ('[10/4/5]', 0.5),
        ('[FIX[SIN[30]*2]]', 1),
        ('[FIX[COS[-60]*2]]', 1),
        ('[90 MOD ASIN[0.5]]', 0),
        ('[FIX[TAN[45]]]', 1),
        ('[7 XOR COS[90]]', 0),  # it is not 0 on LinuxCNC, either
        ('[ATAN[0]/[-1 MOD 1]]', 180),  # MOD is -0, as in LinuxCNC
    ],
)
def test_expressions(expression, value):
    head = '#1=5 #2=1\n#<depth>=8\nDEF REAL A_B=9, C_D\nR5=7\n'
    assert xs(head + f'G0 X0\nG0 X{expression}')[-1] == pytest.approx(value)


CONTINUED = 'O1 do\n#1=[#1+1]\nO2 if [#1 EQ 3]\nO1 continue\nO2 endif\nO1 while [#1 LT 3]\n'
REPEATED = 'O3 repeat [2]\nG91 G0 X1\nO3 endrepeat\nM2\n'


def test_a_repeat_that_linuxcnc_counts_wrongly_is_refused():
    """Its rs274 runs the lines four times: the continue of a DO loop is still counted."""
    with pytest.raises(ProgramError, match=':8: O3 REPEAT: LinuxCNC repeats too often'):
        xs(f'#1=0\n{CONTINUED}{REPEATED}')
    between = 'O4 while [#1 LT 9]\n#1=[#1+1]\nO4 endwhile\n'
    assert xs(f'G0 X0\n#1=0\n{CONTINUED}{between}{REPEATED}') == [0, 1, 2]
    assert xs(f'G0 X0\n#1=0\n{CONTINUED.replace("EQ 3", "EQ 9")}{REPEATED}') == [0, 1, 2]


def test_a_tangent_without_a_value_is_refused():
    with pytest.raises(ProgramError, match='no value'):
        xs('G0 X[TAN[90]]')


@pytest.mark.parametrize(
    'loop',
    [
        'O1 while [#1 LT 4]\nG0 X#1\n#1=[#1+1]\nO1 endwhile',
        'o<up> while [#1 lt 4]\nG0 X#1\n#1=[#1+1]\no<up> endwhile (done)',
        'WHILE [#1 LT 4] DO1\nG0 X#1\n#1=#1+1\nEND1',
        'WHILE [#1 LT 4] DO1\nG0 X#1\nIF [#1 GT 0] GOTO 5\nX9\nN5 #1=#1+1\nEND1',
        'O1 do\nG0 X#1\n#1=[#1+1]\nO1 while [#1 LT 4]',
        'O1 repeat [3]\nG0 X#1\n#1=[#1+1]\nO1 endrepeat',
        'N10 G0 X#1\n#1=#1+1\nIF [#1 LT 4] GOTO 10',
        'AGAIN: G0 X=#1\n#1=#1+1\nIF #1<4 GOTOB AGAIN',
        'O1 while [1]\nO2 if [#1 GE 4]\nO1 break\nO2 endif\nG0 X#1\n#1=[#1+1]\nO1 endwhile',
        'O1 while [#1 LT 4]\nG0 X#1\n#1=[#1+1]\nO1 continue\nG0 X99\nO1 endwhile',
        'GOTOF ON\nG0 X99\nON: G0 X1\nGOTO 30\nX99\nN30 X2\nX3',
        'IF [#1 EQ 1] THEN #2=2\nG0 X1\nX#2\nIF [#1 EQ 2] THEN #2=9\nX[#2+1]',
        'O1 call [3]\nM2\nO1 sub\n#2=1\nO2 while [#2 LE #1]\nG0 X#2\n#2=[#2+1]\nO2 endwhile\n'
        'O1 endsub',
        'O1 sub\nG0 X#1\nO1 endsub\nO1 call [1]\nO1 call [2]\nO1 call [1+2]',
        'G65 P9 A1\nG65 P9 A2\nG65 P9 X3 A3\nM30\nO9\nG0 X#1\nM99',
        'G0 X0\nM98 P12 L3\nM30\nO0012\nG91 G0 X1\nG90\nM99',
        'M98 P30012\nM30\nO12\nG91 G0 X1\nG90\nM99',
        'O1 if [#1 EQ 2]\nG0 X9\nO1 elseif [#1 EQ 1]\nG0 X1\nO1 else\nG0 X8\nO1 endif\nX2\nX3',
        'O1 if [#1 EQ 2]\nG0 X9\nO1 else\nG0 X1\nO1 endif\nX2\nX3',
        'O1 do\nG0 X#1\n#1=[#1+1]\nO1 continue\nX9\nO1 while [#1 LT 4]',
        'O1 repeat [3]\nG91 G0 X1\nO1 continue\nX9\nO1 endrepeat',
        'O1 sub\nO1 return [#1+1]\nO1 endsub\nO2 repeat [3]\nG0 X#<_value>\nO1 call '
        '[#<_value>]\nO2 endrepeat\nX#<_value>',
        '#2=7\nO7 sub\nG0 X#1\nO7 endsub\nO#2 call [1]\nO[#2] call [2]\nO<a b> sub\nX3\n'
        'O<a b> endsub\nO<a b> call',
        'G91\nO1 sub\nM73\nG90 G0 X1\nO1 endsub\nO1 call\nX1\nM70\nG90\nM72\nX1',
        'G0 X[EXISTS[#1] * 1]\nX[1+EXISTS[##1]]\nX[3-EXISTS[#99999]]',
        'G0 X[#<_x>+1]\nX[#<_abs_x>+1]\nX[#<_incremental>+3]',
        'G0 X#<_spindle_rpm_mode>\nX[#<_spindle_css_mode>+2]\nX[#<_absolute>+2]',
        'G65 P9 A1\nG65 P9 A2\nG65 P9 B3\nM30\nO9\nIF [#1 NE #0] GOTO 8\n#1=#2\nN8 G0 X#1\nM99',
        '#100=9\nG65 P9 A1\nIF [#100 EQ #0] THEN #100=2\nX#100\nX3\nM30\nO9\nG0 X#1\n#100=#0\nM99',
        'IF R1<>1\nX9\nELSE\nIF TRUE\nX1\nENDIF\nENDIF\nX2\nX3',
        'DEF INT A_B\nFOR A_B=1 TO 3\nX=A_B\nENDFOR',
        'R2=0\nREPEAT\nR2=R2+1\nX=R2\nUNTIL R2>2',
        'R2=0\nLOOP\nR2=R2+1\nIF R2>3 GOTOF OUT_1\nX=R2\nENDLOOP\nOUT_1:',
        'R2=0\nWHILE R2<3\nR2=R2+1\nIF R2==9\nX9\nELSE\nX=R2\nENDIF\nENDWHILE',
        'R2=0\nWHILE R2<3\nR2=R2+1\nX=R2\nIF R2>0 GOTOF ON_1\nX9\nON_1: ENDWHILE',
        'CASE (R1+1) OF 5 GOTOF C_A 2 GOTOF C_B DEFAULT GOTOF C_C\nC_A: X9\nC_B: X1\nX2\nC_C: X3',
        'DEF REAL A_B[2,2]=SET(0,1,2)\nX=A_B[0,1]\nX=A_B[1,0]\nA_B[1,1]=3\nX=A_B[1,A_B[0,1]]',
        'X1\nGOTOC NOWHERE\nX2\nGOTO 70\nX9\nN70 X3',
        'AGAIN: G0 X=IC(1)\nIF $AA_IW[X]<3 GOTOB AGAIN\nSETAL(65000)',
        'DEF REAL A_B[4]=REP(1)\nX=A_B[3]\nA_B[1]=SET(2,3)\nX=A_B[1]\nX=A_B[2]',
        'DEF INT A_B[4]\nA_B[1]=REP(2,2)\nX=1+A_B[0]\nX=A_B[2]\nX=3+A_B[3]',
        'DEF STRING[9] A_B="ON"\nX1\nIF A_B=="OFF" GOTOF C_A\nA_B="OFF"\nX2\n'
        'IF A_B=="OFF" GOTOF C_A\nX9\nC_A: X3',
        'DEF AXIS A_B[2]=(Y,X)\nDEF AXIS C_D=X\nACC[X]=60\nAX[A_B[1]]=1\nAX[C_D]=IC(1)\nAX[X]=3',
        'X1\nX=$P_EP[X]+1\nDEF AXIS C_D=X\nX=$AA_IM[C_D]+1',
        'R1=6 B_AND 3\nX=R1-1\nX=R1\nX=6 B_XOR 5',
    ],
)
def test_three_steps(loop):
    assert xs('G0 X0\n#1=1\n' + loop + '\nM2') == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ('words', 'found'),
    [
        ('I1 J2 K3 I4 J5 K6 I7', {4: 1, 5: 2, 6: 3, 7: 4, 8: 5, 9: 6, 10: 7}),
        ('I1 I4 D5', {4: 1, 7: 5}),  # the last one of both counts
        ('D5 I1 I4', {4: 1, 7: 4}),
        ('K1 J2 I3', {6: 1, 8: 2, 10: 3}),
        ('A1 ' + 'I2 ' * 9 + 'K9', {1: 1, 4: 2, 28: 2, 30: 9}),
    ],
)
def test_sets_of_i_j_k_are_arguments_one_after_the_other(words, found):
    steps = '\n'.join(f'X#{number}' for number in found)
    text = f'G0 X0\nG65 P9 {words}\nM30\nO9\nG0 Y1\n{steps}\nM99'
    blocks = read_text(text, 'part.nc', ThreeAxes(), Settings()).blocks
    wanted = [x for x, before in zip(found.values(), [0, *found.values()]) if x != before]
    np.testing.assert_allclose(blocks.tip[2:, 0] * 1e3, wanted)
    with pytest.raises(ProgramError, match='written twice'):
        xs('G0 X0\nM98 P9 I1 I2\nO9\nM99')
    with pytest.raises(ProgramError, match='more than ten sets'):
        read_text(text.replace(words, 'I1 ' * 11), 'part.nc', ThreeAxes(), Settings())


@pytest.mark.parametrize(
    ('before', 'number', 'value'),
    [
        ('G1 X2 F300', 4001, 1),
        ('G18', 4002, 18),
        ('G91', 4003, 91),
        ('G1 X2 F300', 4109, 300),
        ('G20 G1 X2 F12', 4109, 12),
        ('S1500', 4119, 1500),
        ('T7 M6', 4120, 7),
        ('G55', 4014, 55),
        ('G81 Z-1 R1 F100', 4009, 81),
        ('G99', 4010, 99),
        ('X3 Y4', 5002, 4),
        ('G92 Y14', 5042, 14),
        ('Y4\nG92 Y14', 5022, 4),
    ],
)
def test_a_macro_reads_the_modal_words_and_places(before, number, value):
    text = f'O0001\nG21 G90 G0 X0 Y0 Z5\n{before}\n#100=#{number}\nG80 G90 G21 G0 X#100\nM30'
    blocks = read_text(text, 'part.nc', ThreeAxes(), Settings()).blocks
    np.testing.assert_allclose(blocks.tip[-1, 0] * 1e3, value)


@pytest.mark.parametrize(
    ('line', 'part'),
    [
        ('#3000=12(NO DIAMETER)', '#3000: the program raises this alarm; NO DIAMETER'),
        ('IF [#5001 LT 1] THEN #3000=1 (TOO FAR)', '#3000: the program raises this alarm; TOO'),
        ('#2001=5', '#2001: a variable of the control'),
        ('#100=#4113', 'the system variable #4113 is not known'),
    ],
)
def test_variables_of_the_control_are_not_set_silently(line, part):
    with pytest.raises(ProgramError, match=part):
        read_text(f'O0001\nG0 X0\n{line}\nX1\nM30', 'part.nc', ThreeAxes(), Settings())
    # A line that is not executed raises nothing; #3006 stops as M0 does.
    text = 'O0001\nG0 X0\nX1\n#3006=1(LOOK)\nGOTO 9\n#3000=1(BAD)\nN9 X2\nM30'
    assert read_text(text, 'part.nc', ThreeAxes(), Settings()).blocks.program_stop[1] == 1


def test_loops_in_loops():
    text = 'G0 X0\n#1=1\nWHILE [#1 LE 2] DO1\n#2=1\nWHILE [#2 LE 2] DO2\nG0 X[10*#1+#2]\n'
    assert xs(text + '#2=#2+1\nEND2\n#1=#1+1\nEND1\nX0') == [0, 11, 12, 21, 22, 0]


def test_subprograms_in_files_of_their_own(tmp_path):
    (tmp_path / 'part.ngc').write_text('G0 X0\no<step> call [1]\nM98 P7\nG0 X3\nM2\n')
    (tmp_path / 'step.ngc').write_text('o<step> sub\nG0 X#1\no<step> endsub\nM2\n')
    (tmp_path / 'O0007.nc').write_text('%\nO7\nG0 X2\nM99\n%\n')
    blocks = read_program(tmp_path / 'part.ngc', ThreeAxes(), Settings()).blocks
    np.testing.assert_allclose(blocks.tip[:, 0] * 1e3, [0, 1, 2, 3])
    # A line of another file counts as the line of its call.
    assert blocks.line_number.tolist() == [1, 2, 3, 4]
    # A file that is called by its name has the variables of who calls.
    (tmp_path / 'L5.spf').write_text('R1=R1+2\n#1=3\nM17\n')
    (tmp_path / 'part.mpf').write_text('R1=1\n#1=1\nG0 X=R1\nL5\nX=R1\nX=R1+#1\nM30\n')
    blocks = read_program(tmp_path / 'part.mpf', ThreeAxes(), Settings()).blocks
    np.testing.assert_allclose(blocks.tip[:, 0] * 1e3, [1, 3, 6])


def test_block_delete():
    text = 'G0 X0\n/G0 X1\n/2 X2\nN5 /X3\nX4'
    assert xs(text) == [0, 1, 2, 3, 4] and xs(text, skip_blocks=True) == [0, 4]


def test_locals_and_positions():
    text = 'G0 X4\n#1=7\nO1 sub\n#1=2\nG0 X[#1 + #5420]\nO1 endsub\nO1 call\nG0 X#1\nM2'
    assert xs(text) == [4, 6, 7]


@pytest.mark.parametrize(
    ('cycle', 'wanted'),
    [
        ('G98 G81 X1 Z-2 R3', [(1, 5), (1, 3), (1, -2), (1, 5)]),
        ('G99 G81 X1 Z-2 R3', [(1, 5), (1, 3), (1, -2), (1, 3)]),
        ('G98 G81 X1 Z-2 R7', [(0, 7), (1, 7), (1, -2), (1, 7)]),
        ('G99 G81 X1 Z-2 R3\nX2', [(1, 5), (1, 3), (1, -2), (1, 3), (2, 3), (2, -2), (2, 3)]),
        ('G99 G83 X1 Z-2 R3 Q3', [(1, 5), (1, 3), (1, 0), (1, 3), (1, 0.254), (1, -2), (1, 3)]),
        ('G99 G73 X1 Z-2 R3 Q3', [(1, 5), (1, 3), (1, 0), (1, 0.254), (1, -2), (1, 3)]),
        ('G99 G81 G91 X1 Z-5 R-2 L2', [(1, 5), (1, 3), (1, -2), (1, 3), (2, 3), (2, -2), (2, 3)]),
        ('G99 G82 X1 Z-2 R3 P0.5', [(1, 5), (1, 3), (1, -2), (1, 3)]),
        ('G99 G85 X1 Z-2 R3', [(1, 5), (1, 3), (1, -2), (1, 3)]),
        ('G81 X1 Z-2 R3\nG80 G1 X4', [(1, 5), (1, 3), (1, -2), (1, 5), (4, 5)]),
    ],
)
def test_canned_cycles(cycle, wanted):
    blocks = read('G0 X0 Z5\nF100\n' + cycle).blocks
    np.testing.assert_allclose(blocks.tip[1:, [0, 2]] * 1e3, wanted, atol=1e-9)
    down = np.flatnonzero(np.diff(blocks.tip[:, 2]) < 0) + 1
    lowest = blocks.tip[:, 2].argmin()
    assert lowest in down and not blocks.rapid[lowest]
    assert blocks.exact_stop[lowest] == any(code in cycle for code in ('G82', 'G85'))
    assert blocks.rapid[lowest + 1 : lowest + 2].all() != ('G85' in cycle)


def test_a_cycle_that_is_repeated_0_times_drills_nothing():
    assert xs('G0 X0 Z5\nF100 G81 X1 Z-2 R3 L0\nG80\nG0 X4') == [0, 4]


def test_cycles_in_the_plane_of_g18():
    blocks = read('G18 G0 X0 Y5 Z0 F100\nG99 G81 X1 Z2 Y-2 R3').blocks
    np.testing.assert_allclose(blocks.tip[1:] * 1e3, [[1, 5, 2], [1, 3, 2], [1, -2, 2], [1, 3, 2]])


def test_blocks_stream_with_flat_memory_and_progress(tmp_path):
    path = tmp_path / 'long.ngc'
    line = 'G1 X{:.3f} Y{:.3f}\n'
    with path.open('w') as file:
        file.write('G0 X0 Y0 F1000\n')
        file.writelines(line.format(i % 97, i % 89) for i in range(60000))
    stream = open_program(path, ThreeAxes(), Settings())
    shares, rows, largest = [], 0, 0
    for blocks in stream:
        shares.append(stream.share)
        rows += len(blocks)
        assert rows / 60000 == pytest.approx(stream.share, abs=0.05)
        largest = max(largest, len(blocks))
    assert rows == 60001 - 1  # the second line repeats the start
    assert shares == sorted(shares) and shares[0] < 0.1 and shares[-1] == 1.0
    assert largest < 30000


def test_messages_tell_values_of_parameters():
    text = 'G0 X0\n#1=[7/2] #<way>=-4\nG1 X1 F100\n  ( Debug, at #1 of #<way>, #9)\nX2 (no, #1)\n'
    assert read(text).notices[-1] == 'line 4: at 3.5 of -4, #9'
