"""Links and joints of a model as a graph: joints that close loops are cut to leave a tree."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import Joint

# Kinds of joints in the order in which they stay in the tree: the last of a loop is cut. A ball
# joint leaves three equations and adds no body, a weld six.
_KEPT = ("weld", "prismatic", "screw", "planar", "universal", "revolute", "ball_rpy")


def loop_joints(plant: MultibodyPlant) -> list[Joint]:
    """Joints without which links and joints of a plant are trees.

    Args:
        plant: not finalized.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    parents = list(range(plant.num_bodies()))

    def root(body: int) -> int:
        while parents[body] != body:
            parents[body] = parents[parents[body]]
            body = parents[body]
        return body

    def rank(joint: Joint) -> int:
        kind = joint.type_name()
        return _KEPT.index(kind) if kind in _KEPT else 0

    cut = []
    for joint in sorted(joints, key=rank):
        ends = [root(int(body.index())) for body in (joint.parent_body(), joint.child_body())]
        if ends[0] == ends[1]:
            cut.append(joint)
        parents[ends[0]] = ends[1]
    return cut


def reversed_joints(plant: MultibodyPlant) -> list[Joint]:
    """Joints whose child is nearer to the world than their parent.

    Args:
        plant: not finalized; its links and joints are trees.
    """
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    children = {int(joint.child_body().index()) for joint in joints}
    bodies = range(plant.num_bodies())
    # The world first, then what hangs on nothing, then the rest.
    reached, backwards = set[int](), list[Joint]()
    for start in sorted(bodies, key=lambda body: (body in children, body)):
        front = [start] if start not in reached else []
        reached.update(front)
        while front:
            body = front.pop()
            for joint in joints:
                parent, child = (int(b.index()) for b in (joint.parent_body(), joint.child_body()))
                if body in (parent, child):
                    far = child if body == parent else parent
                    if far not in reached:
                        reached.add(far)
                        front.append(far)
                        if far == parent:
                            backwards.append(joint)
    return backwards
