"""Distances on a bridge from above: see `armctl.scene.BridgeMap`.

Blocks are rows (k, 10): the sides left, bottom, right and top of what is near a block, m, beyond which an edge is not
near it; then the block's centre, the cosine and sine of its yaw, and its half sizes.
"""

import math

from armctl.kernels.compiling import compiled


@compiled
def segment_to_block(ax, ay, bx, by, block):
    """Distance of a segment from a block, m; 0 if they meet.

    Separate ones are nearest at an end of the segment, or at the block's foremost corner towards it.
    """
    cos, sin, half_x, half_y = block[6], block[7], block[8], block[9]
    ax, ay, bx, by = ax - block[4], ay - block[5], bx - block[4], by - block[5]
    ax, ay, bx, by = ax * cos + ay * sin, ay * cos - ax * sin, bx * cos + by * sin, by * cos - bx * sin
    x, y, wx, wy = (ax + bx) / 2, (ay + by) / 2, (bx - ax) / 2, (by - ay) / 2
    lateral = x * wy - y * wx
    if (
        abs(x) <= half_x + abs(wx)
        and abs(y) <= half_y + abs(wy)
        and abs(lateral) <= half_x * abs(wy) + half_y * abs(wx)
    ):
        return 0.0
    corner_x, corner_y = math.copysign(half_x, lateral * wy) - x, math.copysign(half_y, -lateral * wx) - y
    share = (corner_x * wx + corner_y * wy) / max(wx * wx + wy * wy, 1e-24)
    share = min(max(share, -1.0), 1.0)
    to_corner = math.hypot(corner_x - share * wx, corner_y - share * wy)
    to_a = math.hypot(max(abs(ax) - half_x, 0.0), max(abs(ay) - half_y, 0.0))
    to_b = math.hypot(max(abs(bx) - half_x, 0.0), max(abs(by) - half_y, 0.0))
    return min(to_corner, to_a, to_b)


@compiled
def edge_is_free(blocks, half_width, length, clearance, ax, ay, bx, by):
    """Whether an edge keeps a clearance from blocks, sides and ends of the deck."""
    if max(abs(ay), abs(by)) > half_width - clearance:
        return False
    if min(ax, bx) < clearance or max(ax, bx) > length - clearance:
        return False
    for k in range(len(blocks)):
        left, bottom, right, top = blocks[k, 0], blocks[k, 1], blocks[k, 2], blocks[k, 3]
        apart = (ax < left and bx < left) or (ax > right and bx > right)
        apart = apart or (ay < bottom and by < bottom) or (ay > top and by > top)
        if not apart and segment_to_block(ax, ay, bx, by, blocks[k]) < clearance:
            return False
    return True
