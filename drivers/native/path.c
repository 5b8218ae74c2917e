/* What a live tick does with its frames, in C: drivers/native/__init__.py says when it is used.
 *
 * Every function has a twin in Python, which says what it means: receive_block.py, stage_fd.py, cia402/host.py,
 * pacing.py, record_builder.py. tests/drivers/test_native.py holds them equal. */
#define _GNU_SOURCE
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <errno.h>
#include <math.h>
#include <stdint.h>
#include <string.h>
#include <sys/socket.h>
#include <time.h>

enum { SECOND = 1000000000, STAMP = 1000, DATA_AT = 8, MOST_DATA = 64, FRAME_BYTES = 72, CONTROL_BYTES = 64 };
enum { SLOT_BYTES = FRAME_BYTES + CONTROL_BYTES, STAMPED = CMSG_SPACE(sizeof(struct timespec)) };
enum { FEEDBACK = 16, COMMAND = 24, RECORDED = 80, AXES = 4 };
enum { TPDO = 6, WATCHED_TPDO = 7, TORQUE_MODE = 10, ECHO = -1, ROW = 6 };
#define ERROR_FLAG 0x20000000u
#define FD_FLAG 0x04
#define ECHO_FLAG 0x80

static uint32_t crc_table[256];

static void make_crc_table(void) {
    for (uint32_t n = 0; n < 256; n++) {
        uint32_t c = n;
        for (int bit = 0; bit < 8; bit++) {
            c = c & 1 ? 0xEDB88320u ^ c >> 1 : c >> 1;
        }
        crc_table[n] = c;
    }
}

static uint32_t crc32_of(const uint8_t *data, size_t length, uint32_t begin) {
    uint32_t c = ~begin;
    for (size_t i = 0; i < length; i++) {
        c = crc_table[(c ^ data[i]) & 0xFF] ^ c >> 8;
    }
    return ~c;
}

static uint32_t read_u32(const uint8_t *at) {
    return (uint32_t)at[0] | (uint32_t)at[1] << 8 | (uint32_t)at[2] << 16 | (uint32_t)at[3] << 24;
}

static uint16_t read_u16(const uint8_t *at) { return (uint16_t)(at[0] | at[1] << 8); }

static void put_u16(uint8_t *at, uint16_t value) { at[0] = (uint8_t)value, at[1] = (uint8_t)(value >> 8); }

static void put_u32(uint8_t *at, uint32_t value) { put_u16(at, (uint16_t)value), put_u16(at + 2, (uint16_t)(value >> 16)); }

static void put_i64(uint8_t *at, int64_t value) { put_u32(at, (uint32_t)value), put_u32(at + 4, (uint32_t)(value >> 32)); }

/* As Python's %: the sign of the divisor. */
static int64_t modulo(int64_t value, int64_t divisor) {
    int64_t rest = value % divisor;
    return rest < 0 ? rest + divisor : rest;
}

static int expects(const char *name, Py_ssize_t given, Py_ssize_t wanted) {
    if (given != wanted) {
        PyErr_Format(PyExc_TypeError, "%s() takes %zd arguments, %zd given", name, wanted, given);
        return 0;
    }
    return 1;
}

/* n integers from args on; 0 with an exception where one is none. */
static int integers(PyObject *const *args, int n, int64_t *into) {
    for (int i = 0; i < n; i++) {
        into[i] = PyLong_AsLongLong(args[i]);
        if (into[i] == -1 && PyErr_Occurred()) {
            return 0;
        }
    }
    return 1;
}

static PyObject *too_small(const char *name) {
    PyErr_Format(PyExc_ValueError, "%s(): the memory is too small", name);
    return NULL;
}

/* receive(fd, headers, slots) -> count: recvmmsg(2) without waiting; 0: nothing was queued. Raises OSError. */
static PyObject *receive(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t fd, slots;
    Py_buffer headers;
    if (!expects("receive", n, 3) || !integers(args, 1, &fd) || !integers(args + 2, 1, &slots) ||
        PyObject_GetBuffer(args[1], &headers, PyBUF_WRITABLE)) {
        return NULL;
    }
    struct mmsghdr *into = headers.buf;
    int fits = 0 <= slots && slots <= headers.len / (Py_ssize_t)sizeof *into;
    PyBuffer_Release(&headers); /* its owner keeps the memory */
    if (!fits) {
        return too_small("receive");
    }
    int count = recvmmsg((int)fd, into, (unsigned)slots, MSG_DONTWAIT, NULL);
    if (count < 0) {
        return errno == EAGAIN ? PyLong_FromLong(0) : PyErr_SetFromErrno(PyExc_OSError);
    }
    return PyLong_FromLong(count);
}

/* One frame of the class `type`, a NamedTuple of four. Steals `data`. */
static PyObject *frame(PyTypeObject *type, uint32_t can_id, PyObject *data, PyObject *flags, int64_t stamp) {
    PyObject *made = type->tp_alloc(type, 4), *id = PyLong_FromUnsignedLong(can_id), *at = PyLong_FromLongLong(stamp);
    if (made == NULL || data == NULL || id == NULL || at == NULL) {
        Py_XDECREF(made), Py_XDECREF(data), Py_XDECREF(id), Py_XDECREF(at);
        return NULL;
    }
    PyTuple_SET_ITEM(made, 0, id);
    PyTuple_SET_ITEM(made, 1, data);
    PyTuple_SET_ITEM(made, 2, Py_NewRef(flags));
    PyTuple_SET_ITEM(made, 3, at);
    return made;
}

static int is_plain(const struct mmsghdr *header, int64_t size) {
    return header->msg_hdr.msg_controllen == STAMPED && header->msg_hdr.msg_flags == 0 && header->msg_len == size;
}

/* The frames of `count` messages; Py_None: they are for the slow path. */
static PyObject *frames_of(struct mmsghdr *headers, const uint8_t *slots, int64_t count, PyTypeObject *type,
                           int64_t size, int64_t head, PyObject *flags, int64_t offset, int64_t earliest,
                           int64_t latest) {
    if (latest - earliest >= SECOND) {
        Py_RETURN_NONE;
    }
    int64_t last = modulo(latest + offset, SECOND), first = last - (latest - earliest), base = latest - last;
    for (int64_t i = 0; i < count; i++) {
        const uint8_t *slot = slots + i * SLOT_BYTES;
        const struct timespec *arrived = (const struct timespec *)(slot + FRAME_BYTES + CMSG_LEN(0));
        if (!is_plain(&headers[i], size) || read_u16(slot + 4) != head || arrived->tv_nsec < first ||
            arrived->tv_nsec > last || read_u32(slot) & ERROR_FLAG) {
            Py_RETURN_NONE;
        }
    }
    PyObject *frames = PyList_New(count);
    for (int64_t i = 0; frames != NULL && i < count; i++) {
        const uint8_t *slot = slots + i * SLOT_BYTES;
        const struct timespec *arrived = (const struct timespec *)(slot + FRAME_BYTES + CMSG_LEN(0));
        int64_t stamp = base + arrived->tv_nsec;
        PyObject *data = PyBytes_FromStringAndSize((const char *)slot + DATA_AT, slot[4]);
        PyObject *made = frame(type, read_u32(slot), data, flags, stamp - modulo(stamp, STAMP));
        if (made == NULL) {
            Py_CLEAR(frames);
        } else {
            PyList_SET_ITEM(frames, i, made);
        }
    }
    for (int64_t i = 0; frames != NULL && i < count; i++) {
        headers[i].msg_hdr.msg_controllen = CONTROL_BYTES;
        headers[i].msg_len = 0;
    }
    return frames;
}

/* frames(headers, slots, count, Frame, size, head, flags, offset_ns, earliest_ns, latest_ns) -> list or None */
static PyObject *frames(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t count, of_frame[2], times[3];
    Py_buffer headers, slots;
    if (!expects("frames", n, 10) || !integers(args + 2, 1, &count) || !integers(args + 4, 2, of_frame) ||
        !integers(args + 7, 3, times) || PyObject_GetBuffer(args[0], &headers, PyBUF_WRITABLE)) {
        return NULL;
    }
    PyObject *found = NULL;
    if (PyObject_GetBuffer(args[1], &slots, PyBUF_SIMPLE) == 0) {
        if (!PyType_Check(args[3]) || !PyType_IsSubtype((PyTypeObject *)args[3], &PyTuple_Type)) {
            PyErr_SetString(PyExc_TypeError, "frames(): the class of a frame is a tuple");
        } else if (count < 0 || headers.len < count * (Py_ssize_t)sizeof(struct mmsghdr) ||
                   slots.len < count * SLOT_BYTES || (of_frame[1] & 0xFF) > MOST_DATA) {
            too_small("frames");
        } else {
            found = frames_of(headers.buf, slots.buf, count, (PyTypeObject *)args[3], of_frame[0], of_frame[1],
                              args[6], times[0], times[1], times[2]);
        }
        PyBuffer_Release(&slots);
    }
    PyBuffer_Release(&headers);
    return found;
}

/* What a feedback frame says, into four numbers: position, status, sequence, stamp_ns; 0 for a wrong checksum. */
static int read_feedback(const uint8_t *data, int64_t can_id, int64_t received_ns, int64_t *into) {
    if (crc32_of(data, FEEDBACK - 4, (uint32_t)can_id) != read_u32(data + FEEDBACK - 4)) {
        return 0;
    }
    int64_t earliest = received_ns - ((int64_t)1 << 31);
    into[0] = (int32_t)read_u32(data), into[1] = read_u16(data + 8), into[2] = read_u16(data + 10);
    into[3] = earliest + (int64_t)(uint32_t)(read_u32(data + 4) - (uint64_t)earliest);
    return 1;
}

/* feedback(data, can_id, received_ns) -> (position, status, sequence, stamp_ns), or None for a wrong checksum */
static PyObject *feedback(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t given[2], found[4];
    if (!expects("feedback", n, 3) || !integers(args + 1, 2, given)) {
        return NULL;
    }
    if (!PyBytes_Check(args[0]) || PyBytes_GET_SIZE(args[0]) != FEEDBACK) {
        return too_small("feedback");
    }
    if (!read_feedback((const uint8_t *)PyBytes_AS_STRING(args[0]), given[0], given[1], found)) {
        Py_RETURN_NONE;
    }
    return Py_BuildValue("LLLL", (long long)found[0], (long long)found[1], (long long)found[2], (long long)found[3]);
}

/* What a frame, a NamedTuple of four, is made of. */
typedef struct {
    int64_t can_id, flags, stamp;
    const uint8_t *data;
    Py_ssize_t length;
} Parts;

/* Its parts; 0 with an exception where it is none. */
static int take_apart(PyObject *frame, Parts *into) {
    if (!PyTuple_Check(frame) || PyTuple_GET_SIZE(frame) != 4 || !PyBytes_Check(PyTuple_GET_ITEM(frame, 1))) {
        PyErr_SetString(PyExc_TypeError, "no frame");
        return 0;
    }
    into->can_id = PyLong_AsLongLong(PyTuple_GET_ITEM(frame, 0));
    into->flags = PyLong_AsLongLong(PyTuple_GET_ITEM(frame, 2));
    into->stamp = PyLong_AsLongLong(PyTuple_GET_ITEM(frame, 3));
    into->data = (const uint8_t *)PyBytes_AS_STRING(PyTuple_GET_ITEM(frame, 1));
    into->length = PyBytes_GET_SIZE(PyTuple_GET_ITEM(frame, 1));
    return !PyErr_Occurred();
}

/* Six numbers of a frame (axis, position, status, sequence, stamp_ns, received_ns), as its layout reads it; 0: it is
 * no answer that can be read here. */
typedef int (*Reader)(void *layout, const Parts *frame, int64_t *into);

/* Six i64, little-endian, of each of the first frames, up to one that cannot be read here. */
static PyObject *rows(PyObject *list, Reader read, void *layout) {
    int64_t found[ROW];
    PyObject *frames = PySequence_Fast(list, "no list of frames");
    Py_ssize_t count = frames == NULL ? 0 : PySequence_Fast_GET_SIZE(frames), i = 0;
    PyObject *all = frames == NULL ? NULL : PyBytes_FromStringAndSize(NULL, count * (Py_ssize_t)sizeof found);
    Parts frame;
    while (all != NULL && i < count && take_apart(PySequence_Fast_GET_ITEM(frames, i), &frame) &&
           read(layout, &frame, found)) {
        for (int k = 0; k < ROW; k++) {
            put_i64((uint8_t *)PyBytes_AS_STRING(all) + i * (Py_ssize_t)sizeof found + 8 * k, found[k]);
        }
        i++;
    }
    if (all != NULL && i < count) {
        PyErr_Clear();
        _PyBytes_Resize(&all, i * (Py_ssize_t)sizeof found);
    }
    Py_XDECREF(frames);
    return all;
}

/* first_id, axes, most_status */
static int read_stage(void *layout, const Parts *frame, int64_t *into) {
    const int64_t *of = layout;
    into[0] = frame->can_id - of[0], into[5] = frame->stamp;
    return 0 <= into[0] && into[0] < of[1] && frame->flags & FD_FLAG && frame->length == FEEDBACK &&
           read_feedback(frame->data, frame->can_id, frame->stamp, into + 1) && into[2] <= of[2];
}

/* answers(frames, first_id, axes, most_status) -> rows of stage_fd's */
static PyObject *answers(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t given[3];
    if (!expects("answers", n, 4) || !integers(args + 1, 3, given)) {
        return NULL;
    }
    return rows(args[0], read_stage, given);
}

typedef struct {
    const uint8_t *usual; /* by axis: can_id (u32), statusword (u16), status (u16) */
    int64_t axes, length, significant, sync_id, echo_ns, heard;
} Tpdos;

static int read_tpdo(void *layout, const Parts *frame, int64_t *into) {
    Tpdos *of = layout;
    into[3] = -1, into[5] = frame->stamp;
    if (frame->can_id == of->sync_id && frame->flags & ECHO_FLAG && frame->stamp >= 0) {
        into[0] = ECHO, into[1] = into[2] = 0, into[4] = of->echo_ns = frame->stamp;
        return 1;
    }
    if (of->echo_ns < 0 || frame->flags & FD_FLAG || frame->length != of->length) {
        return 0;
    }
    for (int64_t axis = 0; axis < of->axes; axis++) {
        const uint8_t *usual = of->usual + 8 * axis;
        if (frame->can_id == read_u32(usual)) {
            into[0] = axis, into[1] = (int32_t)read_u32(frame->data), into[2] = read_u16(usual + 6);
            into[4] = of->echo_ns;
            int as_usual = (read_u16(frame->data + 4) & of->significant) == read_u16(usual + 4) &&
                           (of->length == TPDO || frame->data[TPDO] == TORQUE_MODE);
            of->heard |= (int64_t)as_usual << axis;
            return as_usual;
        }
    }
    return 0;
}

/* tpdos(frames, usual, length, significant, sync_id) -> (rows of cia402's, echo_ns or -1, bits of the axes heard) */
static PyObject *tpdos(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t given[3];
    Py_buffer usual;
    if (!expects("tpdos", n, 5) || !integers(args + 2, 3, given) || PyObject_GetBuffer(args[1], &usual, PyBUF_SIMPLE)) {
        return NULL;
    }
    Tpdos layout = {usual.buf, usual.len / 8, given[0], given[1], given[2], -1, 0};
    int fits = layout.axes <= AXES && (layout.length == TPDO || layout.length == WATCHED_TPDO);
    PyObject *read = fits ? rows(args[0], read_tpdo, &layout) : too_small("tpdos");
    PyBuffer_Release(&usual);
    return read == NULL ? NULL : Py_BuildValue("NLL", read, (long long)layout.echo_ns, (long long)layout.heard);
}

/* torques(forces, rated, gains, limits, enable) -> 6071h of each axis, i16 each; None: a force is beyond its rated one */
static PyObject *torques(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t enable, axes = -1;
    uint8_t data[2 * AXES];
    PyObject *list[4] = {NULL};
    if (!expects("torques", n, 5) || !integers(args + 4, 1, &enable)) {
        return NULL;
    }
    int sound = 1;
    for (int i = 0; sound && i < 4; i++) {
        list[i] = PySequence_Fast(args[i], "torques(): no list of numbers");
        axes = i == 0 && list[i] != NULL ? PySequence_Fast_GET_SIZE(list[i]) : axes;
        sound = list[i] != NULL && axes <= AXES && PySequence_Fast_GET_SIZE(list[i]) == axes;
    }
    for (int64_t axis = 0; sound && axis < axes; axis++) {
        double of[4]; /* force, rated force, gain, limit */
        for (int i = 0; i < 4; i++) {
            of[i] = PyFloat_AsDouble(PySequence_Fast_GET_ITEM(list[i], axis));
        }
        sound = -of[1] <= of[0] && of[0] <= of[1] && !PyErr_Occurred();
        double value = sound && enable >> axis & 1 ? rint(of[0] * of[2]) : 0.0;
        value = value < -of[3] ? -of[3] : value > of[3] ? of[3] : value;
        put_u16(data + 2 * axis, (uint16_t)(int16_t)value);
    }
    for (int i = 0; i < 4; i++) {
        Py_XDECREF(list[i]);
    }
    if (!sound) {
        return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
    }
    return PyBytes_FromStringAndSize((const char *)data, 2 * axes);
}

/* command(can_id, forces, limits, sequence, flags) -> the 24 bytes of a command frame; None: a force is beyond them */
static PyObject *command(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t can_id, counts[2];
    uint8_t data[COMMAND] = {0};
    if (!expects("command", n, 5) || !integers(args, 1, &can_id) || !integers(args + 3, 2, counts)) {
        return NULL;
    }
    if (!PyTuple_Check(args[2]) || PyTuple_GET_SIZE(args[2]) != AXES) {
        PyErr_SetString(PyExc_TypeError, "command(): a tuple of four limits");
        return NULL;
    }
    PyObject *forces = PySequence_Fast(args[1], "command(): no list of forces");
    int sound = forces != NULL && PySequence_Fast_GET_SIZE(forces) <= AXES;
    for (Py_ssize_t axis = 0; sound && axis < PySequence_Fast_GET_SIZE(forces); axis++) {
        double force = PyFloat_AsDouble(PySequence_Fast_GET_ITEM(forces, axis));
        double limit = PyFloat_AsDouble(PyTuple_GET_ITEM(args[2], axis));
        sound = -limit <= force && force <= limit && !PyErr_Occurred();
        float single = (float)force;
        uint32_t bits;
        memcpy(&bits, &single, sizeof bits);
        put_u32(data + 4 * axis, bits);
    }
    Py_XDECREF(forces);
    if (!sound) {
        return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
    }
    put_u16(data + 16, (uint16_t)counts[0]);
    put_u16(data + 18, (uint16_t)counts[1]);
    put_u32(data + COMMAND - 4, crc32_of(data, COMMAND - 4, (uint32_t)can_id));
    return PyBytes_FromStringAndSize((const char *)data, COMMAND);
}

/* tuple_as(type, items): tuple.__new__, which takes eight times as many instructions to find that out */
static PyObject *tuple_as(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    if (!expects("tuple_as", n, 2)) {
        return NULL;
    }
    if (!PyType_Check(args[0]) || !PyType_IsSubtype((PyTypeObject *)args[0], &PyTuple_Type)) {
        PyErr_SetString(PyExc_TypeError, "tuple_as(): the class is a tuple's");
        return NULL;
    }
    PyTypeObject *type = (PyTypeObject *)args[0];
    PyObject *items = PySequence_Fast(args[1], "tuple_as(): no items");
    PyObject *made = items == NULL ? NULL : type->tp_alloc(type, PySequence_Fast_GET_SIZE(items));
    for (Py_ssize_t i = 0; made != NULL && i < PySequence_Fast_GET_SIZE(items); i++) {
        PyTuple_SET_ITEM(made, i, Py_NewRef(PySequence_Fast_GET_ITEM(items, i)));
    }
    Py_XDECREF(items);
    return made;
}

/* One frame as a record keeps it, RECORDED bytes; 0 with an exception where it is none. */
static int keep(uint8_t *at, PyObject *frame) {
    Parts of;
    if (!take_apart(frame, &of)) {
        return 0;
    }
    if (of.length > MOST_DATA) {
        too_small("keep");
        return 0;
    }
    int64_t head = of.can_id | (int64_t)of.length << 32 | of.flags << 40;
    memcpy(at, &of.stamp, 8);
    memcpy(at + 8, &head, 8);
    memcpy(at + 16, of.data, (size_t)of.length);
    memset(at + 16 + of.length, 0, (size_t)(MOST_DATA - of.length));
    return 1;
}

/* A list of frames into a record's memory, from byte `begin` on; 0 with an exception where they do not fit. */
static int keep_frames(const Py_buffer *memory, int64_t begin, PyObject *list) {
    PyObject *frames = PySequence_Fast(list, "record(): no list of frames");
    if (frames == NULL) {
        return 0;
    }
    Py_ssize_t count = PySequence_Fast_GET_SIZE(frames);
    int whole = 0 <= begin && count <= (memory->len - begin) / RECORDED;
    if (!whole) {
        too_small("record");
    }
    for (Py_ssize_t i = 0; whole && i < count; i++) {
        whole = keep((uint8_t *)memory->buf + begin + i * RECORDED, PySequence_Fast_GET_ITEM(frames, i));
    }
    Py_DECREF(frames);
    return whole;
}

/* The words but for the motion's, and that, into a record's memory, up to byte `last`; 0 where they do not fit. */
static int keep_words(const Py_buffer *part, int64_t begin, int64_t end, int64_t last) {
    uint8_t *memory = part[0].buf, *words = part[1].buf;
    if (begin < 0 || end < begin || last < end || part[0].len < last || part[1].len < last || part[2].len < end - begin) {
        too_small("record");
        return 0;
    }
    memcpy(memory, words, (size_t)begin);
    memcpy(memory + begin, part[2].buf, (size_t)(end - begin));
    memcpy(memory + end, words + end, (size_t)(last - end));
    return 1;
}

/* record(memory, words, motion, begin, end, sent_at, sent, received_at, received): all of a record; places in bytes */
static PyObject *record(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t edges[3], received_at;
    Py_buffer part[3];
    if (!expects("record", n, 9) || !integers(args + 3, 3, edges) || !integers(args + 7, 1, &received_at)) {
        return NULL;
    }
    int held = 0;
    while (held < 3 && PyObject_GetBuffer(args[held], &part[held], held ? PyBUF_SIMPLE : PyBUF_WRITABLE) == 0) {
        held++;
    }
    int whole = held == 3 && keep_words(part, edges[0], edges[1], edges[2]) && keep_frames(part, edges[2], args[6]) &&
                keep_frames(part, received_at, args[8]);
    while (held > 0) {
        PyBuffer_Release(&part[--held]);
    }
    if (!whole) {
        return NULL;
    }
    Py_RETURN_NONE;
}

/* copy(to, begin, source): the bytes of `source` into `to`, from byte `begin` on */
static PyObject *copy(PyObject *Py_UNUSED(module), PyObject *const *args, Py_ssize_t n) {
    int64_t begin;
    Py_buffer to, source;
    if (!expects("copy", n, 3) || !integers(args + 1, 1, &begin) || PyObject_GetBuffer(args[0], &to, PyBUF_WRITABLE)) {
        return NULL;
    }
    int whole = 0;
    if (PyObject_GetBuffer(args[2], &source, PyBUF_SIMPLE) == 0) {
        whole = 0 <= begin && source.len <= to.len - begin;
        if (whole) {
            memcpy((uint8_t *)to.buf + begin, source.buf, (size_t)source.len);
        } else {
            too_small("copy");
        }
        PyBuffer_Release(&source);
    }
    PyBuffer_Release(&to);
    if (!whole) {
        return NULL;
    }
    Py_RETURN_NONE;
}

static PyObject *sleep_to(PyObject *deadline, int alone) {
    int64_t until_ns;
    if (!integers(&deadline, 1, &until_ns)) {
        return NULL;
    }
    struct timespec until = {until_ns / SECOND, until_ns % SECOND};
    for (;;) {
        int result;
        if (alone) {
            result = clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        } else {
            Py_BEGIN_ALLOW_THREADS;
            result = clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
            Py_END_ALLOW_THREADS;
        }
        if (result == 0) {
            Py_RETURN_NONE;
        }
        if (result != EINTR) {
            errno = result;
            return PyErr_SetFromErrnoWithFilename(PyExc_OSError, "clock_nanosleep");
        }
        if (PyErr_CheckSignals() < 0) {
            return NULL;
        }
    }
}

/* sleep_until(deadline_ns), and the same without letting another thread of this process run meanwhile */
static PyObject *sleep_until(PyObject *Py_UNUSED(module), PyObject *deadline) { return sleep_to(deadline, 0); }

static PyObject *sleep_alone(PyObject *Py_UNUSED(module), PyObject *deadline) { return sleep_to(deadline, 1); }

#define FAST(function) {#function, (PyCFunction)(void (*)(void))(function), METH_FASTCALL, NULL}

static PyMethodDef methods[] = {
    FAST(receive),
    FAST(frames),
    FAST(feedback),
    FAST(answers),
    FAST(tpdos),
    FAST(torques),
    FAST(command),
    FAST(tuple_as),
    FAST(record),
    FAST(copy),
    {"sleep_until", sleep_until, METH_O, NULL},
    {"sleep_alone", sleep_alone, METH_O, NULL},
    {NULL, NULL, 0, NULL},
};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, "path", NULL, -1, methods, NULL, NULL, NULL, NULL};

PyMODINIT_FUNC PyInit_path(void) {
    make_crc_table();
    return PyModule_Create(&definition);
}
