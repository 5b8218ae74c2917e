"""Emergency messages of an emulated node: when they come, and when none may."""

from drivers.families.cia402.cia301 import EMCY, PDO_INVALID, Emergency
from sim_plant.drives.emergency import EmergencyProducer
from sim_plant.drives.object_dictionary import ObjectDictionary, key_of

COB_ID, INHIBIT = key_of(0x1014), key_of(0x1015)


def test_they_wait_for_the_inhibit_time_and_without_an_identifier_none_is_kept() -> None:
    dictionary = ObjectDictionary(5)
    dictionary.values[COB_ID], dictionary.values[INHIBIT] = 0x85, 20  # of 100 us
    producer = EmergencyProducer(dictionary)
    codes = [Emergency.HEARTBEAT, Emergency.NONE]
    for code in codes:
        producer.raise_error(code, 0x11)
    told = [producer.due(now_ns) for now_ns in (1000, 2_000_999, 2_001_000, 9_000_000)]
    assert [[frame.can_id for frame in frames] for frames in told] == [[0x85], [], [0x85], []]
    assert [EMCY.unpack(frames[0].data)[0] for frames in told if frames] == [int(code) for code in codes]
    dictionary.values[COB_ID] = PDO_INVALID | 0x85
    producer.raise_error(Emergency.HEARTBEAT, 0x11)
    assert producer.due(90_000_000) == []
    dictionary.values[COB_ID] = 0x85
    assert producer.due(100_000_000) == [], "what was not told then is not told later"
