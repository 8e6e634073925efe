/* The Python binding of llfsm_whiteboard.h: a Board, and a Port for one slot of it. It is thin on
 * purpose: a call costs the encoder's or decoder's work and a few atomic operations. The
 * interpreter's lock serialises a process's threads and is released only while waiting. tp_new
 * initialises an object completely; during a call, only the board can change: it may be closed. */
#include "_board.h"
#include "_fields.h"

#include <math.h>
#include <structmember.h>

static PyTypeObject *port_type;
static PyObject *sample_type; /* llfsm.whiteboard.board.Sample */

typedef struct {
    PyObject_HEAD
    Board *board;
    struct lwb_slot slot;
    PyTypeObject *type;      /* the exact type of its messages */
    struct field_checks checks;
    PyObject *name, *encode_into, *decode;
    _PyCFunctionFast encode; /* what encode_into calls, if it is such a function; otherwise NULL */
    PyObject *scratch;       /* a bytearray to encode into; NULL while a thread uses it */
    PyObject *message;       /* the latest message decoded */
    struct lwb_meta meta;    /* and its metadata */
    uint64_t added;          /* the count of the last message that it has added */
    char makes;              /* it makes its slot, and takes its name back by reserving it */
    char retired;            /* it adds no more */
    char reads;              /* it has declared that it reads the slot */
} Port;

#include "_reading.h"

static PyObject *port_new(PyTypeObject *subtype, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"board", "name", "type_name", "schema", "fingerprint", "capacity",
                            "message_type", "fields", "encode_into", "decode", "make", NULL};
    struct lwb_schema schema;
    unsigned long long fingerprint, capacity;
    PyObject *board, *name, *type, *fields, *encode_into, *decode;
    int make = true;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!UssKKO!O!OO|p", names, board_type, &board,
                                     &name, &schema.type, &schema.text, &fingerprint, &capacity,
                                     &PyType_Type, &type, &PyTuple_Type, &fields, &encode_into,
                                     &decode, &make))
        return NULL;
    schema.fingerprint = fingerprint;
    schema.capacity = capacity;
    Port *self = (Port *)PyType_GenericAlloc(subtype, 0);
    if (!self)
        return NULL;
    self->makes = (char)make;
    self->board = (Board *)Py_NewRef(board);
    self->name = Py_NewRef(name);
    self->type = (PyTypeObject *)Py_NewRef(type);
    self->encode_into = Py_NewRef(encode_into);
    self->decode = Py_NewRef(decode);
    if (PyCFunction_CheckExact(encode_into) && PyCFunction_GetFlags(encode_into) == METH_FASTCALL)
        self->encode = (_PyCFunctionFast)(void (*)(void))PyCFunction_GetFunction(encode_into);
    if (!(schema.name = PyUnicode_AsUTF8AndSize(name, NULL)) ||
        field_checks_init(&self->checks, self->type, fields) || !is_open(self->board, name))
        goto failed;
    int status = lwb_bind(&self->board->board, &self->slot, &schema, make);
    if (!status)
        return (PyObject *)self;
    if (status == LWB_MISSING) {
        PyErr_SetNone(PyExc_LookupError);
        goto failed;
    }
    PyObject *theirs = NULL;
    if (status == LWB_DIFFERS) {
        const struct lwb_frame *f = &self->slot.frame;
        theirs = PyBytes_FromStringAndSize(lwb_texts(self->slot.record) + f->type_length + 1,
                                           (Py_ssize_t)f->schema_length);
    }
    fail(status, name, theirs);
failed:
    Py_DECREF(self);
    return NULL;
}

/* No tp_clear: a port never changes its references except that to its message, and messages are
 * immutable. So, as with a tuple, every cycle contains another object that can be cleared. */
static int port_traverse(Port *self, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE((PyObject *)self));
    Py_VISIT(self->type);
    Py_VISIT(self->encode_into);
    Py_VISIT(self->decode);
    Py_VISIT(self->message);
    return 0;
}

static void port_dealloc(Port *self)
{
    PyTypeObject *subtype = Py_TYPE((PyObject *)self);
    PyObject_GC_UnTrack(self);
    field_checks_free(&self->checks);
    port_end_reading(self);
    Py_XDECREF(self->message);
    Py_XDECREF(self->scratch);
    Py_DECREF(self->decode);
    Py_DECREF(self->encode_into);
    Py_DECREF(self->type);
    Py_DECREF(self->name);
    Py_DECREF(self->board);
    PyObject_GC_Del(self);
    Py_DECREF(subtype);
}

/* If the slot's record has another name by now, bind the slot again: make it if `create`, or return
 * LWB_MISSING if it is not on the board. What was read before is forgotten. */
static int port_renew(Port *self, bool create)
{
    if (!lwb_is_renamed(&self->slot))
        return LWB_OK;
    port_end_reading(self);
    self->meta = (struct lwb_meta){0};
    Py_CLEAR(self->message);
    const char *name = PyUnicode_AsUTF8AndSize(self->name, NULL);
    return name ? lwb_renew(&self->slot, name, create) : LWB_INVALID;
}

/* Encode a message into `scratch`. The limited API's call with two objects would take a tenth of an
 * add, so msgspec's encoder is called as the C function that it is. */
static PyObject *port_encode(Port *self, PyObject *message, PyObject *scratch)
{
    PyObject *arguments[] = {message, scratch};
    if (self->encode)
        return self->encode(PyCFunction_GetSelf(self->encode_into), arguments, 2);
    return PyObject_CallFunctionObjArgs(self->encode_into, message, scratch, NULL);
}

/* Add if the slot's count is `after`, or unconditionally if that is LWB_ANY. */
static PyObject *port_put(Port *self, PyObject *message, uint64_t after)
{
    if (!is_open(self->board, self->name))
        return NULL;
    if (Py_TYPE(message) != self->type) { /* another class of the same type, or an error */
        PyObject *same = PyObject_CallFunction(as_type, "OOO", self->name, self->type, message);
        bool made = same && Py_TYPE(same) == self->type;
        PyObject *added = made ? port_put(self, same, after) : NULL;
        Py_XDECREF(same);
        return added;
    }
    if (self->retired)
        return fail(RETIRED, self->name, NULL);
    /* Taken, not borrowed: the encoder may let another thread run, which then makes its own. */
    PyObject *scratch = self->scratch;
    self->scratch = NULL;
    if (!scratch && !(scratch = PyByteArray_FromStringAndSize(NULL, 0)))
        return NULL;
    PyObject *done = port_encode(self, message, scratch);
    if (done && !field_checks_hold(&self->checks, message)) {
        Py_DECREF(done);
        done = PyObject_CallFunctionObjArgs(self->decode, scratch, NULL); /* the decoder decides */
    }
    uint64_t count = 0;
    size_t length = (size_t)PyByteArray_Size(scratch);
    int status;
    do status = !done ? WRONG_FIELD
              : self->board->closed ? CLOSED
              : (status = port_renew(self, true)) ? status
              : lwb_add_after(&self->slot, PyByteArray_AsString(scratch), length, after, &count);
    while (status == LWB_RENAMED);
    if (self->scratch || length > 1 << 20) /* keep one, and not a huge one */
        Py_DECREF(scratch);
    else
        self->scratch = scratch;
    Py_XDECREF(done);
    if (status == WRONG_FIELD)
        return fail(status, self->name, Py_BuildValue("ON", self->type, take_error()));
    if (status == LWB_DIFFERS)
        return fail(status, self->name, NULL);
    if (status && status != LWB_PASSED)
        return fail(status, self->name, Py_BuildValue("nK", (Py_ssize_t)length,
                                                      (unsigned long long)self->slot.capacity));
    if (!status)
        self->added = count;
    return PyLong_FromUnsignedLongLong(count);
}

static PyObject *port_add(Port *self, PyObject *message)
{
    return port_put(self, message, LWB_ANY);
}

/* add_after(message, count): returns 0 if another message was added after that count. */
static PyObject *port_add_after(Port *self, PyObject *args)
{
    PyObject *message, *number;
    if (!PyArg_ParseTuple(args, "OO!", &message, &PyLong_Type, &number))
        return NULL;
    unsigned long long after = PyLong_AsUnsignedLongLong(number);
    if (PyErr_Occurred())
        return NULL;
    return port_put(self, message, after);
}

/* Whether self->message is the latest: the whole cost of a get if nothing was added. */
static inline bool is_fresh(Port *self)
{
    return self->message && !self->board->closed &&
           lwb_word(&self->slot) == self->meta.word;
}

static int port_copy(Port *self, void *data, size_t room, struct lwb_meta *meta)
{
    int status;
    do status = (status = port_renew(self, false)) ? status
              : lwb_read(&self->slot, data, room, meta);
    while (status == LWB_RENAMED);
    return status == LWB_MISSING ? LWB_EMPTY : status;
}

/* The latest message's bytes and metadata; NULL without an exception if nothing was added yet. */
static PyObject *port_read(Port *self, struct lwb_meta *meta)
{
    char near[256]; /* enough for most messages; a longer one is read again with its size */
    int status = port_copy(self, near, sizeof near, meta);
    if (!status && meta->length <= sizeof near)
        return PyBytes_FromStringAndSize(near, (Py_ssize_t)meta->length);
    PyObject *data = NULL;
    size_t room = 0;
    while (!status && meta->length > room) {
        room = meta->length;
        Py_XDECREF(data);
        if (!(data = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)room)))
            return NULL;
        status = port_copy(self, PyBytes_AsString(data), room, meta);
    }
    if (!status && meta->length == room)
        return data;
    PyObject *shorter = NULL; /* than the message whose size was read first */
    if (!status)
        shorter = PyBytes_FromStringAndSize(PyBytes_AsString(data), (Py_ssize_t)meta->length);
    else if (status != LWB_EMPTY)
        fail(status, self->name, NULL);
    Py_XDECREF(data);
    return shorter;
}

/* Update self->message. Returns 1 if there is one, 0 if nothing was added yet, -1 on error. */
static int port_refresh(Port *self)
{
    if (!is_open(self->board, self->name))
        return -1;
    struct lwb_meta meta;
    PyObject *data = port_read(self, &meta);
    port_begin_reading(self);
    if (!data)
        return PyErr_Occurred() ? -1 : 0;
    PyObject *message = PyObject_CallFunctionObjArgs(self->decode, data, NULL);
    Py_DECREF(data);
    if (!message) {
        fail(UNREADABLE, self->name, Py_BuildValue("ONKK", self->type, take_error(),
                                                   (unsigned long long)meta.process,
                                                   (unsigned long long)meta.count));
        return -1;
    }
    if (meta.count > self->meta.count) { /* otherwise another thread has stored a newer one */
        PyObject *old = self->message;
        self->message = message;
        self->meta = meta;
        Py_XDECREF(old);
    } else
        Py_DECREF(message);
    return 1;
}

static PyObject *port_get(Port *self, PyObject *unused)
{
    (void)unused;
    if (is_fresh(self))
        return Py_NewRef(self->message);
    int state = port_refresh(self);
    return state < 0 ? NULL : Py_NewRef(state ? self->message : Py_None);
}

static PyObject *port_sample(Port *self, PyObject *unused)
{
    (void)unused;
    int state = is_fresh(self) ? 1 : port_refresh(self);
    if (state < 0)
        return NULL;
    if (!state)
        Py_RETURN_NONE;
    return PyObject_CallFunction(sample_type, "NKKK", Py_NewRef(self->message),
                                 (unsigned long long)self->meta.count,
                                 (unsigned long long)self->meta.stamp,
                                 (unsigned long long)self->meta.process);
}

/* encoded(): (data, count, stamp, process), data not validated; None before the first. */
static PyObject *port_encoded(Port *self, PyObject *unused)
{
    (void)unused;
    struct lwb_meta meta;
    PyObject *data = is_open(self->board, self->name) ? port_read(self, &meta) : NULL;
    if (data)
        return Py_BuildValue("NKKK", data, (unsigned long long)meta.count,
                             (unsigned long long)meta.stamp, (unsigned long long)meta.process);
    return PyErr_Occurred() ? NULL : Py_NewRef(Py_None);
}

static PyObject *port_count(Port *self, void *unused)
{
    (void)unused;
    int status = is_open(self->board, self->name) ? port_renew(self, false) : CLOSED;
    if (status && status != LWB_MISSING)
        return fail(status, self->name, NULL);
    return PyLong_FromUnsignedLongLong(lwb_count(&self->slot));
}

static PyObject *port_retire(Port *self, PyObject *unused)
{
    (void)unused;
    self->retired = 1;
    Py_RETURN_NONE;
}

static PyObject *port_reserve(Port *self, PyObject *unused)
{
    (void)unused;
    if (!is_open(self->board, self->name))
        return NULL;
    int status;
    if (!self->makes) {
        status = lwb_make_ready_if_named(&self->slot);
        return status && status != LWB_RENAMED ? fail(status, self->name, NULL) : Py_NewRef(Py_None);
    }
    do status = (status = port_renew(self, true)) ? status : lwb_make_ready(&self->slot);
    while (status == LWB_RENAMED);
    return status ? fail(status, self->name, NULL) : Py_NewRef(Py_None);
}

#include "_recent.h"
#include "_waiting.h"
#include "_dozing.h"

static PyMethodDef port_methods[] = {
    {"add", (PyCFunction)port_add, METH_O, NULL},
    {"add_after", (PyCFunction)port_add_after, METH_VARARGS, NULL},
    {"get", (PyCFunction)port_get, METH_NOARGS, NULL},
    {"sample", (PyCFunction)port_sample, METH_NOARGS, NULL},
    {"encoded", (PyCFunction)port_encoded, METH_NOARGS, NULL},
    {"wait", (PyCFunction)(void (*)(void))port_wait, METH_VARARGS | METH_KEYWORDS, NULL},
    {"wait_count", (PyCFunction)(void (*)(void))port_wait_count, METH_VARARGS | METH_KEYWORDS,
     NULL},
    {"recent", (PyCFunction)port_recent, METH_NOARGS, NULL},
    {"reserve", (PyCFunction)port_reserve, METH_NOARGS, NULL},
    {"retire", (PyCFunction)port_retire, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL}};

static PyGetSetDef port_getset[] = {
    {"count", (getter)port_count, NULL, NULL, NULL},
    {NULL, NULL, NULL, NULL, NULL}};

static PyMemberDef port_members[] = {
    {"added", T_ULONGLONG, offsetof(Port, added), READONLY, NULL},
    {"capacity", T_ULONGLONG, offsetof(Port, slot.capacity), READONLY, NULL},
    {NULL, 0, 0, 0, NULL}};

/* Final, so that the interpreter can call a port's methods directly. */
static PyType_Slot port_type_slots[] = {
    {Py_tp_new, port_new},
    {Py_tp_dealloc, port_dealloc},
    {Py_tp_traverse, port_traverse},
    {Py_tp_methods, port_methods},
    {Py_tp_getset, port_getset},
    {Py_tp_members, port_members},
    {0, NULL}};

static PyType_Spec port_spec = {
    .name = "llfsm.whiteboard._shm.Port",
    .basicsize = sizeof(Port),
    .flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .slots = port_type_slots,
};

static PyMethodDef functions[] = {{"wait_any", (PyCFunction)(void (*)(void))wait_any,
                                   METH_FASTCALL, NULL},
                                  {NULL, NULL, 0, NULL}};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_shm", .m_size = -1,
                                    .m_methods = functions};

/* The methods of BoundSlot that are the same for every board are written in Python. Port does not
 * inherit from BoundSlot, so its type is given them. */
static int add_shared_methods(void)
{
    PyObject *bound_slot = look_up("llfsm.whiteboard.board", "BoundSlot");
    const char *const names[] = {"subscribe", "stream", "on_add"};
    int status = bound_slot ? 0 : -1;
    for (size_t i = 0; !status && i < sizeof names / sizeof *names; i++) {
        PyObject *method = PyObject_GetAttrString(bound_slot, names[i]);
        status = method ? PyObject_SetAttrString((PyObject *)port_type, names[i], method) : -1;
        Py_XDECREF(method);
    }
    Py_XDECREF(bound_slot);
    return status;
}

PyMODINIT_FUNC PyInit__shm(void)
{
    if (!(sample_type = look_up("llfsm.whiteboard.board", "Sample")) ||
        !(raise_status = look_up("llfsm.whiteboard.errors", "raise_status")) ||
        !(as_type = look_up("llfsm.whiteboard.message", "as_type")) ||
        !(board_type = (PyTypeObject *)PyType_FromSpec(&board_spec)) ||
        !(port_type = (PyTypeObject *)PyType_FromSpec(&port_spec)) ||
        !(doze_type = (PyTypeObject *)PyType_FromSpec(&doze_spec)) || add_shared_methods())
        return NULL;
    PyObject *m = PyModule_Create(&module);
    if (m && (PyModule_AddType(m, board_type) || PyModule_AddType(m, port_type) ||
              PyModule_AddType(m, doze_type)))
        Py_CLEAR(m);
    return m;
}
