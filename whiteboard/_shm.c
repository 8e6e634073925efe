/* The Python binding of llfsm_whiteboard.h: a Board, and a Port for one slot of it. It is thin on
 * purpose: a call costs the encoder's or decoder's work and a few atomic operations. The
 * interpreter's lock serialises a process's threads and is released only while waiting. tp_new
 * initialises an object completely; during a call, only the board can change: it may be closed. */
#include "_board.h"
#include "_fields.h"

#include <math.h>

static PyObject *sample_type; /* llfsm.whiteboard.board.Sample */

typedef struct {
    PyObject_HEAD
    Board *board;
    struct lwb_slot slot;
    PyTypeObject *type;      /* the exact type of its messages */
    struct field_checks checks;
    PyObject *name, *encode_into, *decode;
    PyObject *scratch;       /* a bytearray to encode into; NULL while a thread uses it */
    PyObject *message;       /* the latest message decoded */
    struct lwb_meta meta;    /* and its metadata */
    char retired;            /* it adds no more */
} Port;

static PyObject *port_new(PyTypeObject *subtype, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"board", "name", "type_name", "schema", "fingerprint", "capacity",
                            "message_type", "fields", "encode_into", "decode", NULL};
    struct lwb_schema schema;
    unsigned long long fingerprint, capacity;
    PyObject *board, *name, *type, *fields, *encode_into, *decode;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "O!UssKKO!O!OO", names, &BoardType, &board,
                                     &name, &schema.type, &schema.text, &fingerprint, &capacity,
                                     &PyType_Type, &type, &PyTuple_Type, &fields, &encode_into,
                                     &decode))
        return NULL;
    schema.fingerprint = fingerprint;
    schema.capacity = capacity;
    Port *self = (Port *)subtype->tp_alloc(subtype, 0);
    if (!self)
        return NULL;
    self->board = (Board *)Py_NewRef(board);
    self->name = Py_NewRef(name);
    self->type = (PyTypeObject *)Py_NewRef(type);
    self->encode_into = Py_NewRef(encode_into);
    self->decode = Py_NewRef(decode);
    if (!(schema.name = PyUnicode_AsUTF8(name)) ||
        field_checks_init(&self->checks, self->type, fields) || !is_open(self->board, name))
        goto failed;
    int status = lwb_slot(&self->board->board, &self->slot, &schema);
    if (!status)
        return (PyObject *)self;
    PyObject *theirs = NULL;
    if (status == LWB_DIFFERS) {
        struct lwb_record *r = self->slot.record;
        theirs = PyBytes_FromStringAndSize(lwb_texts(r) + r->name_length + r->type_length,
                                           (Py_ssize_t)r->schema_length);
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
    Py_VISIT(self->type);
    Py_VISIT(self->encode_into);
    Py_VISIT(self->decode);
    Py_VISIT(self->message);
    return 0;
}

static void port_dealloc(Port *self)
{
    PyObject_GC_UnTrack(self);
    field_checks_free(&self->checks);
    Py_XDECREF(self->message);
    Py_XDECREF(self->scratch);
    Py_DECREF(self->decode);
    Py_DECREF(self->encode_into);
    Py_DECREF(self->type);
    Py_DECREF(self->name);
    Py_DECREF(self->board);
    Py_TYPE(self)->tp_free((PyObject *)self);
}

/* Add if the slot's count is `after`, or unconditionally if that is LWB_ANY. */
static PyObject *port_put(Port *self, PyObject *message, uint64_t after)
{
    if (!is_open(self->board, self->name))
        return NULL;
    if (Py_TYPE(message) != self->type)
        return fail(WRONG_TYPE, self->name, PyTuple_Pack(2, self->type, message));
    if (self->retired)
        return fail(RETIRED, self->name, NULL);
    /* Taken, not borrowed: the encoder may let another thread run, which then makes its own. */
    PyObject *scratch = self->scratch;
    self->scratch = NULL;
    if (!scratch && !(scratch = PyByteArray_FromStringAndSize(NULL, 0)))
        return NULL;
    PyObject *arguments[] = {message, scratch};
    PyObject *done = PyObject_Vectorcall(self->encode_into, arguments, 2, NULL);
    if (done && !field_checks_hold(&self->checks, message))
        Py_SETREF(done, PyObject_CallOneArg(self->decode, scratch)); /* the decoder decides */
    uint64_t count = 0;
    size_t length = (size_t)PyByteArray_GET_SIZE(scratch);
    int status = !done ? WRONG_FIELD
               : self->board->closed ? CLOSED
               : lwb_add_after(&self->slot, PyByteArray_AS_STRING(scratch), length, after, &count);
    if (self->scratch || length > 1 << 20) /* keep one, and not a huge one */
        Py_DECREF(scratch);
    else
        self->scratch = scratch;
    Py_XDECREF(done);
    if (status == WRONG_FIELD)
        return fail(status, self->name, Py_BuildValue("ON", self->type, take_error()));
    if (status && status != LWB_PASSED)
        return fail(status, self->name, Py_BuildValue("nK", (Py_ssize_t)length,
                                                      (unsigned long long)self->slot.capacity));
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

/* The latest message's bytes and metadata; NULL without an exception if nothing was added yet. */
static PyObject *port_read(Port *self, struct lwb_meta *meta)
{
    char near[256]; /* enough for most messages; a longer one is read again with its size */
    int status = lwb_read(&self->slot, near, sizeof near, meta);
    if (!status && meta->length <= sizeof near)
        return PyBytes_FromStringAndSize(near, (Py_ssize_t)meta->length);
    PyObject *data = NULL;
    for (size_t room = 0; !status && meta->length > room;) {
        room = meta->length;
        Py_XDECREF(data);
        if (!(data = PyBytes_FromStringAndSize(NULL, (Py_ssize_t)room)))
            return NULL;
        status = lwb_read(&self->slot, PyBytes_AS_STRING(data), room, meta);
    }
    if (!status)
        _PyBytes_Resize(&data, (Py_ssize_t)meta->length);
    else {
        Py_CLEAR(data);
        if (status != LWB_EMPTY)
            fail(status, self->name, NULL);
    }
    return data;
}

/* Update self->message. Returns 1 if there is one, 0 if nothing was added yet, -1 on error. */
static int port_refresh(Port *self)
{
    if (!is_open(self->board, self->name))
        return -1;
    struct lwb_meta meta;
    PyObject *data = port_read(self, &meta);
    if (!data)
        return PyErr_Occurred() ? -1 : 0;
    PyObject *message = PyObject_CallOneArg(self->decode, data);
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

static PyObject *port_wait(Port *self, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"after", "timeout", NULL};
    PyObject *number = NULL, *timeout = Py_None;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "|$O!O", names, &PyLong_Type, &number,
                                     &timeout))
        return NULL;
    if (!number) {
        PyErr_SetString(PyExc_TypeError, "wait() needs the keyword 'after': a count");
        return NULL;
    }
    unsigned long long after = PyLong_AsUnsignedLongLong(number);
    if (PyErr_Occurred())
        return NULL;
    double seconds = timeout == Py_None ? HUGE_VAL : PyFloat_AsDouble(timeout);
    if (seconds == -1 && PyErr_Occurred())
        return NULL;
    struct timespec start, now;
    clock_gettime(CLOCK_MONOTONIC, &start);
    while (is_open(self->board, self->name)) {
        clock_gettime(CLOCK_MONOTONIC, &now);
        double left = seconds - (double)(now.tv_sec - start.tv_sec) -
                      (double)(now.tv_nsec - start.tv_nsec) * 1e-9;
        bool over = !(left > 0); /* NaN counts as over, too */
        int status;
        self->board->users++;
        Py_BEGIN_ALLOW_THREADS
        status = lwb_wait(&self->slot, after, over ? 0 : left > 1 ? 1000000000u
                                                       : (uint64_t)(left * 1e9));
        Py_END_ALLOW_THREADS
        board_leave(self->board);
        if (PyErr_CheckSignals())
            return NULL;
        if (status == LWB_OK)
            return port_sample(self, NULL);
        if (over)
            Py_RETURN_NONE;
        if (!self->board->closed && !lwb_linked(&self->board->board))
            return fail(REMOVED, self->name, NULL); /* no new process can open it and add */
    }
    return NULL;
}

static PyObject *port_count(Port *self, void *unused)
{
    (void)unused;
    return is_open(self->board, self->name) ? PyLong_FromUnsignedLongLong(lwb_count(&self->slot))
                                            : NULL;
}

static PyObject *port_capacity(Port *self, void *unused)
{
    (void)unused;
    return PyLong_FromUnsignedLongLong(self->slot.capacity);
}

static PyObject *port_retire(Port *self, PyObject *unused)
{
    (void)unused;
    self->retired = 1;
    Py_RETURN_NONE;
}

static PyMethodDef port_methods[] = {
    {"add", (PyCFunction)port_add, METH_O, NULL},
    {"add_after", (PyCFunction)port_add_after, METH_VARARGS, NULL},
    {"get", (PyCFunction)port_get, METH_NOARGS, NULL},
    {"sample", (PyCFunction)port_sample, METH_NOARGS, NULL},
    {"encoded", (PyCFunction)port_encoded, METH_NOARGS, NULL},
    {"wait", (PyCFunction)(void (*)(void))port_wait, METH_VARARGS | METH_KEYWORDS, NULL},
    {"retire", (PyCFunction)port_retire, METH_NOARGS, NULL},
    {NULL, NULL, 0, NULL}};

static PyGetSetDef port_getset[] = {
    {"count", (getter)port_count, NULL, NULL, NULL},
    {"capacity", (getter)port_capacity, NULL, NULL, NULL},
    {NULL, NULL, NULL, NULL, NULL}};

/* Final, so that the interpreter can call a port's methods directly. */
static PyTypeObject PortType = {
    PyVarObject_HEAD_INIT(NULL, 0).tp_name = "llfsm.whiteboard._shm.Port",
    .tp_basicsize = sizeof(Port),
    .tp_flags = Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC,
    .tp_new = port_new,
    .tp_dealloc = (destructor)port_dealloc,
    .tp_traverse = (traverseproc)port_traverse,
    .tp_methods = port_methods,
    .tp_getset = port_getset,
};

static struct PyModuleDef module = {PyModuleDef_HEAD_INIT, .m_name = "_shm", .m_size = -1};

static PyObject *look_up(const char *module_name, const char *name)
{
    PyObject *found = PyImport_ImportModule(module_name);
    PyObject *result = found ? PyObject_GetAttrString(found, name) : NULL;
    Py_XDECREF(found);
    return result;
}

/* The methods of BoundSlot that are the same for every board, written in Python. Port does not
 * inherit from BoundSlot, so they are put into its dictionary before the type is made ready. */
static PyObject *shared_methods(void)
{
    PyObject *bound_slot = look_up("llfsm.whiteboard.board", "BoundSlot");
    PyObject *methods = bound_slot ? PyDict_New() : NULL;
    const char *const names[] = {"subscribe", "stream"};
    for (size_t i = 0; methods && i < sizeof names / sizeof *names; i++) {
        PyObject *method = PyObject_GetAttrString(bound_slot, names[i]);
        if (!method || PyDict_SetItemString(methods, names[i], method))
            Py_CLEAR(methods);
        Py_XDECREF(method);
    }
    Py_XDECREF(bound_slot);
    return methods;
}

PyMODINIT_FUNC PyInit__shm(void)
{
    if (!(sample_type = look_up("llfsm.whiteboard.board", "Sample")) ||
        !(raise_status = look_up("llfsm.whiteboard.errors", "raise_status")) ||
        !(PortType.tp_dict = shared_methods()) || PyType_Ready(&BoardType) ||
        PyType_Ready(&PortType))
        return NULL;
    PyObject *m = PyModule_Create(&module);
    if (m && (PyModule_AddObjectRef(m, "Board", (PyObject *)&BoardType) ||
              PyModule_AddObjectRef(m, "Port", (PyObject *)&PortType)))
        Py_CLEAR(m);
    return m;
}
