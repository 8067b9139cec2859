"""What a Python with COMPAS FAB reads from a result, as JSON on stdout; started by test_compas.py.

Arguments: a result folder, a URDF of its arm, a service, and the file of a cell with two arms.
"""

import json
import sys
from pathlib import Path

import compas.geometry
import compas_fab.robots
import compas_robots
import tandem_client
import tandem_compas
from compas.datastructures import Mesh
from compas.geometry import Frame

out, urdf, url, facing = sys.argv[1:]


def main() -> None:
    client = tandem_client.Client(url)
    motion = tandem_compas.read(out)
    frames = tandem_compas.frames(motion, "left", "poses")
    assert all(isinstance(item, compas.geometry.Frame) for item in frames)
    said = {"frames": [[*item.point, *item.xaxis, *item.yaxis] for item in frames]}

    # its own kinematics of the same URDF lead to the same frames, by names of joints
    model = compas_robots.RobotModel.from_urdf_file(urdf)
    rows = tandem_compas.configurations(motion, "left", "poses")
    said["flange"] = [
        [*item.point, *item.xaxis, *item.yaxis]
        for item in (model.forward_kinematics(row, link_name="tool0") for row in rows)
    ]
    said["joints"] = rows[0].joint_names

    trajectory = tandem_compas.trajectory(motion, "left", "poses", [f"cell_{i}" for i in range(6)])
    assert isinstance(trajectory, compas_fab.robots.JointTrajectory)
    assert trajectory.points[-1].joint_names == [f"cell_{i}" for i in range(6)]
    said["times"] = [item.time_from_start.seconds for item in trajectory.points]
    said["trajectory"] = [list(item.joint_values) for item in trajectory.points]
    again = compas_fab.robots.JointTrajectory.__from_data__(trajectory.__data__)
    assert again.time_from_start == trajectory.time_from_start

    said["base"] = [*tandem_compas.base(motion, "left").point]
    said["block"] = [*tandem_compas.block(motion, name="poses").point]
    holder = {**motion["operations"][0], "block": {"held_by": "left", "in_tcp": [0, 0, 10, 1, 0, 0, 0, 1, 0]}}
    said["held"] = [*tandem_compas.block({**motion, "operations": [holder]}, 2).point]
    said["refused"] = []
    for wrong in (
        lambda: tandem_compas.frames(motion, "left"),
        lambda: tandem_compas.frames(motion, "right", "poses"),
        lambda: tandem_compas.base(motion, "right"),
        lambda: tandem_compas.trajectory(motion, "left", "poses", ["a"]),
        lambda: tandem_compas.targets({"left": frames, "right": []}, 20),
    ):
        try:
            wrong()
        except ValueError as error:
            said["refused"].append(str(error))

    # frames as poses of a problem, which a service plans to the same frames
    turned = Frame([0.1, 0.2, 0.3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    said["pose"] = tandem_compas.pose(turned)
    cell = {
        "arms": [
            {
                "name": "left",
                "robot": "irb140",
                "tool": {"kind": "wire_holder", "mounting": "along", "side": "start"},
                "home_deg": [0, 0, 0, 0, 45, 0],
            }
        ]
    }
    place = tandem_compas.pose(Frame([0.45, 0, 0], [1, 0, 0], [0, 1, 0]))
    poses = {"name": "poses", "process": "targets", "arms": ["left"], "file": "t.json", "frame": "world"}
    problem = {
        "tandem": 1,
        "name": "compas",
        "cell": cell,
        "stock": {"size_mm": [100, 100, 100], "place": place},
        "operations": [poses],
    }
    job = client.submit(problem, files={"t.json": tandem_compas.targets({"left": frames}, 20)})
    said["state"] = client.wait(job)["state"]
    planned = tandem_compas.frames(client.motion(job), "left")
    said["planned"] = [[*item.point, *item.xaxis, *item.yaxis] for item in planned]

    # a mesh as a part, in its own unit, and meshes of a result
    points = [
        [x / 1e3, y / 1e3, 0.06 + x * x / 2e5] for x in range(-60, 61, 10) for y in range(-150, 151, 10)
    ]
    faces = [
        [31 * i + j, 31 * i + j + 31, 31 * i + j + 32, 31 * i + j + 1] for i in range(12) for j in range(30)
    ]
    front = Mesh.from_vertices_and_faces(points, faces)
    wire = {"material": "spring_steel", "diameter_mm": 1.5, "length_mm": 520, "temperature_c": 300}
    cut = {
        "name": "faces",
        "process": "elastic_wire",
        "arms": ["left", "right"],
        "wire": wire,
        "kerf_mm": 2.5,
    }
    panel = {
        "tandem": 1,
        "name": "panel",
        "cell": Path(facing),
        "stock": {"size_mm": [180, 400, 110], "support": "pedestal"},
        "part": {"front": {"mesh": tandem_compas.mesh(front)}},
        "operations": [cut],
    }
    said["panel"] = client._upload("/v1/check?reach=false", panel, {})
    (box,) = tandem_compas.meshes({"cut": ([(0, 0, 0), (1000, 0, 0), (0, 2000, 0)], [[0, 1, 2]])}).values()
    said["area"] = box.area()
    print(json.dumps(said))


main()
