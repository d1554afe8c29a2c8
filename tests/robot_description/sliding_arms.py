"""Arms with a joint that slides, as URDFs: one on a linear axis, and one with a telescope."""

from .small_arm import chain_of

Z, Y, X = "0 0 1", "0 1 0", "1 0 0"
SLIDE = '<limit lower="{}" upper="{}" velocity="0.5" effort="500"/>'


def gantry():
    """A chain of five joints that turn, carried along y."""
    ends = '<parent link="rail"/><child link="base"/><origin xyz="0 0 0.3" rpy="0 0 0.3"/><axis xyz="0 1 0"/>'
    rail = f'<link name="rail"/><joint name="rail" type="prismatic">{ends}{SLIDE.format(-0.5, 0.6)}</joint>'
    return chain_of([Z, Y, Y, X, Y], length=0.2).replace("</robot>", f"{rail}</robot>")


def telescope():
    """A chain of joints about and along axes, the third along x."""
    text = chain_of([Z, Y, X, Y, X], length=0.2)
    head, joint, tail = text.partition('<joint name="j3" type="revolute">')
    limit, _, rest = tail.partition("<limit ")[2].partition("/>")
    assert limit
    before = tail.partition("<limit ")[0]
    return head + joint.replace("revolute", "prismatic") + before + SLIDE.format(0, 0.4) + rest
