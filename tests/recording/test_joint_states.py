"""Bags whose messages name their joints: a number belongs to its name, whatever its place in a message."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from labhil.errors import TableError
from labhil.recording import describe_import, import_table
from labhil.rig import parse_rig

ARM = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
TURNED = (*ARM[2:], *ARM[:2])
GRIPPER = ("finger_joint",)
COUNT = 40
Q = np.arange(COUNT)[:, None] * 0.01 + np.arange(6)


def bag(path, messages, topic="/joint_states"):
    """Messages of (s, names, positions); velocities are twice, efforts three times that."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    joint_state, header, time = (
        store.types[kind]
        for kind in ("sensor_msgs/msg/JointState", "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(topic, joint_state.__msgtype__, typestore=store)
        for t, names, q in messages:
            t_ns = 1_700_000_000 * 10**9 + round(t * 1e9)
            told = header(stamp=time(*divmod(t_ns, 10**9)), frame_id="")
            message = joint_state(told, list(names), np.array(q), 2.0 * np.array(q), 3.0 * np.array(q))
            writer.write(connection, t_ns, store.serialize_cdr(message, joint_state.__msgtype__))
    return path


def arm(order, k):
    return (k / 50, order, Q[k, [ARM.index(name) for name in order]])


def rig(column, joints=ARM, extra=""):
    def listed(field):
        return ", ".join(f'"{column.format(field=field, joint=joint)}"' for joint in joints)

    text = "".join(
        f"{signal} = {{ columns = [{listed(field)}] }}\n"
        for signal, field in (
            ("actual_q", "position"),
            ("actual_qd", "velocity"),
            ("actual_current", "effort"),
        )
    )
    return parse_rig(f'[rig]\nkind = "ur5"\n[channels]\n{text}{extra}', Path("rig.toml"))


BY_NAME = rig("/joint_states.{field}.{joint}")
BY_PLACE = rig("/joint_states.{field}[{joint}]", range(6))
EXPECTED = np.hstack([Q, 2.0 * Q, 3.0 * Q])

STEADY = [arm(ARM, k) for k in range(COUNT)]
CHANGING = [arm(ARM if k % 3 else TURNED, k) for k in range(COUNT)]
WITH_GRIPPER = [m for k in range(COUNT) for m in ((k / 50 - 1e-3, GRIPPER, [0.5 * k]), arm(ARM, k))]


@pytest.mark.parametrize(
    "messages", [STEADY, CHANGING, WITH_GRIPPER], ids=["steady", "changing", "gripper first"]
)
def test_joints_are_found_by_their_names(tmp_path, messages):
    table = import_table(bag(tmp_path / "bag", messages), BY_NAME)
    assert table.values == pytest.approx(EXPECTED)
    assert (table.rows, len(table), sum(table.dropped.values())) == (COUNT, COUNT, 0)
    assert table.row.tolist() == list(range(COUNT))


def test_names_may_stand_in_brackets_and_numbers_hold_while_the_order_does(tmp_path):
    path = bag(tmp_path / "bag", [arm(TURNED, k) for k in range(COUNT)])
    assert import_table(path, rig("joint_states.{field}[{joint}]")).values == pytest.approx(EXPECTED)
    turned = [ARM.index(name) for name in TURNED]
    assert import_table(path, BY_PLACE).values[:, :6] == pytest.approx(Q[:, turned])


@pytest.mark.parametrize(
    ("messages", "told"),
    [
        (CHANGING, r"shoulder_pan_joint, .* in 26 messages; .*elbow_joint, .* in 14 messages|"
                   r"elbow_joint, .* in 14 messages; .*shoulder_pan_joint, .* in 26 messages"),
        (WITH_GRIPPER, r"finger_joint in 40 messages"),
    ],
)  # fmt: skip
def test_numbers_are_refused_with_the_names_where_the_order_changes(tmp_path, messages, told):
    with pytest.raises(
        TableError, match=rf"position\[0\]: expected a name, .*({told}).*write the column as"
    ) as e:
        import_table(bag(tmp_path / "bag", messages), BY_PLACE)
    assert "/joint_states.position." in str(e.value)


def test_another_publisher_on_the_topic_is_told(tmp_path):
    said = "\n".join(describe_import(import_table(bag(tmp_path / "bag", WITH_GRIPPER), BY_NAME)))
    assert "rows are the messages of /joint_states with shoulder_pan_joint" in said
    assert "40 messages of /joint_states are no rows: they name finger_joint" in said


def test_a_joint_of_another_publisher_is_taken_at_the_times_of_the_rows(tmp_path):
    last = (*ARM[:5], "finger_joint")
    table = import_table(bag(tmp_path / "bag", WITH_GRIPPER), rig("/joint_states.{field}.{joint}", last))
    assert (len(table), table.rows) == (COUNT - 1, COUNT)  # after the gripper's last message there is nothing
    assert table.values[:, 5] == pytest.approx(0.5 * (np.arange(COUNT - 1) + 0.05), abs=1e-4)


def test_a_joint_that_is_missing_in_a_message_makes_a_bad_row(tmp_path):
    messages = [*STEADY[:10], (10 / 50, ARM[:5], Q[10, :5]), *STEADY[11:]]
    table = import_table(bag(tmp_path / "bag", messages), BY_NAME)
    assert table.dropped["not_finite"] == 1
    assert len(table) == COUNT - 1


def test_a_name_that_is_not_there_is_refused_with_those_that_are(tmp_path):
    with pytest.raises(TableError, match=r"did you mean '/joint_states\.position\.elbow_joint'"):
        import_table(
            bag(tmp_path / "bag", CHANGING), rig("/joint_states.{field}.{joint}", (*ARM[:5], "elbo_joint"))
        )


def test_interfaces_of_named_joints_have_both_names(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    inner = "string[] interface_names\nfloat64[] values\n"
    store.register(get_types_from_msg(inner, "bench_msgs/msg/InterfaceValue"))
    outer = "string[] joint_names\nbench_msgs/InterfaceValue[] interface_values\n"
    store.register(get_types_from_msg(outer, "bench_msgs/msg/DynamicJointState"))
    value, state = (store.types[f"bench_msgs/msg/{kind}"] for kind in ("InterfaceValue", "DynamicJointState"))
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/dynamic", state.__msgtype__, typestore=store)
        for k in range(COUNT):
            of = {
                "motor": value(["voltage", "speed"], np.array([1.0 + k, 2.0 * k])),
                "other": value(["x"], np.ones(1)),
            }
            names = ["motor", "other"] if k % 2 else ["other", "motor"]
            message = state(names, [of[name] for name in names])
            writer.write(connection, k * 10**7, store.serialize_cdr(message, state.__msgtype__))
    text = "".join(
        f'{name} = {{ column = "/dynamic.interface_values.motor.values.{name}" }}\n'
        for name in ("voltage", "speed")
    )
    table = import_table(
        tmp_path / "bag", parse_rig(f'[rig]\nkind = "dc_motor"\n[channels]\n{text}', Path("r.toml"))
    )
    k = np.arange(COUNT)
    assert table.values == pytest.approx(np.column_stack([1.0 + k, 2.0 * k]))
