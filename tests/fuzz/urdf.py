"""Reader of URDF."""

from pathlib import Path

from residual.robot.robot import load_robot
from tests.fuzz.mutation import mutated
from tests.fuzz.reader import Reader
from tests.fuzz.tables import check_robot
from tests.warehouse.conftest import URDF

_CONTINUOUS = URDF.replace("revolute", "continuous").replace(
    '<limit lower="-2" upper="2" velocity="3" effort="50"/>', ""
)
_TOOL = URDF.replace(
    "</robot>",
    '<joint name="tool" type="fixed"><parent link="link2"/><child link="flange"/>'
    '<origin xyz="0 0 0.1" rpy="0 1.57 0"/></joint>'
    '<link name="flange"><visual><geometry><box size="1 1 1"/></geometry></visual>'
    "</link></robot>",
)
_SEEDS = [text.encode() for text in (URDF, _CONTINUOUS, _TOOL)]
_WORDS = tuple(
    b"robot link joint parent child origin axis limit inertial mass inertia revolute "
    b"continuous fixed prismatic mimic link0 link1 link2 joint1 lower upper xyz rpy "
    b"value ixx ixy name type <!-- --> <![CDATA[ ]]> <?xml <!DOCTYPE xacro: /> "
    b"</".split()
)


def _read(data: bytes, place: Path) -> None:
    (place / "arm.urdf").write_bytes(data)
    check_robot(load_robot(place / "arm.urdf"))


URDFS = (Reader("urdf", lambda: mutated(_SEEDS, _WORDS), lambda: _SEEDS, _read),)
