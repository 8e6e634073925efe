/* The Board object, and the conversion of the protocol's status codes to exceptions. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include "llfsm_whiteboard.h"

static PyTypeObject *board_type;
static PyObject *as_type;      /* llfsm.whiteboard.message: (slot, class, message) */
static PyObject *raise_status; /* llfsm.whiteboard.errors: (status, errno, where, detail) */

/* In addition to enum lwb_status. */
enum { CLOSED = -1, WRONG_FIELD = -3, UNREADABLE = -4, REMOVED = -5,
       RETIRED = -6, TRUNCATED = -7 };

/* Raise the Python error for a status, unless one is set already because making `detail` failed.
 * Steals `detail`, which may be NULL. Returns NULL. */
static PyObject *fail(int status, PyObject *where, PyObject *detail)
{
    int number = errno;
    if (!PyErr_Occurred())
        Py_XDECREF(PyObject_CallFunction(raise_status, "iiOO", status, number, where,
                                         detail ? detail : Py_None));
    Py_XDECREF(detail);
    return NULL;
}

/* Clear the current exception and return it (a new reference), to be another one's cause. If it is
 * not an Exception (an interrupt, say), it stays set, and NULL is returned. */
static PyObject *take_error(void)
{
    if (!PyErr_ExceptionMatches(PyExc_Exception))
        return NULL;
    PyObject *type, *value, *traceback;
    PyErr_Fetch(&type, &value, &traceback);
    PyErr_NormalizeException(&type, &value, &traceback);
    if (traceback)
        PyException_SetTraceback(value, traceback);
    Py_XDECREF(type);
    Py_XDECREF(traceback);
    return value;
}

static PyObject *look_up(const char *module_name, const char *name)
{
    PyObject *found = PyImport_ImportModule(module_name);
    PyObject *result = found ? PyObject_GetAttrString(found, name) : NULL;
    Py_XDECREF(found);
    return result;
}

typedef struct {
    PyObject_HEAD
    struct lwb_board board;
    PyObject *path;
    bool closed;
    int users; /* running calls, during which a close must not unmap the board: the last one does.
                * (A forked child may count a thread that it does not have; then dealloc does.) */
} Board;

static PyObject *board_new(PyTypeObject *type, PyObject *args, PyObject *kwargs)
{
    static char *names[] = {"path", "create", "group", NULL};
    PyObject *path;
    int create, group;
    if (!PyArg_ParseTupleAndKeywords(args, kwargs, "Upi", names, &path, &create, &group))
        return NULL;
    Board *self = (Board *)PyType_GenericAlloc(type, 0);
    if (!self)
        return NULL;
    lwb_catch_truncation();
    self->board = (struct lwb_board){.fd = -1, .writer = -1};
    self->path = Py_NewRef(path);
    PyObject *bytes = NULL;
    if (PyUnicode_FSConverter(path, &bytes)) {
        int status = lwb_open_for(&self->board, PyBytes_AsString(bytes), create, (gid_t)group);
        Py_DECREF(bytes);
        if (!status)
            return (PyObject *)self;
        fail(status, path, NULL);
    }
    Py_DECREF(self);
    return NULL;
}

static void board_dealloc(Board *self)
{
    lwb_close(&self->board);
    Py_XDECREF(self->path);
    PyTypeObject *type = Py_TYPE((PyObject *)self);
    PyObject_Free(self);
    Py_DECREF(type);
}

static bool is_open(Board *self, PyObject *where)
{
    if (self->closed || lwb_is_lost(&self->board)) {
        fail(self->closed ? CLOSED : TRUNCATED, where, NULL);
        return false;
    }
    return true;
}

static void board_leave(Board *self)
{
    if (--self->users == 0 && self->closed)
        lwb_close(&self->board);
}

static PyObject *board_close(Board *self, PyObject *unused)
{
    (void)unused;
    self->closed = true;
    if (!self->users)
        lwb_close(&self->board);
    Py_RETURN_NONE;
}

static PyObject *board_linked(Board *self, PyObject *unused)
{
    (void)unused;
    return PyBool_FromLong(!self->closed && lwb_linked(&self->board));
}

static PyObject *board_shared(Board *self, PyObject *unused)
{
    (void)unused;
    return is_open(self, self->path) ? PyBool_FromLong(lwb_shared(&self->board)) : NULL;
}

static PyObject *decoded_name(const union lwb_name *name)
{
    return PyUnicode_DecodeUTF8(name->text, (Py_ssize_t)strlen(name->text), "surrogateescape");
}

/* A slot's record: name and type (decoded as far as possible), schema (None if damaged),
 * fingerprint and capacity. */
static PyObject *board_record(const struct lwb_record *r, const struct lwb_frame *f,
                              const union lwb_name *name, bool damaged)
{
    char type[LWB_MAX_NAME]; /* a copy, as the text may change while it is decoded */
    memcpy(type, lwb_texts(r), f->type_length);
    PyObject *texts[3] = {
        decoded_name(name),
        PyUnicode_DecodeUTF8(type, (Py_ssize_t)f->type_length, "replace"),
        !damaged && lwb_is_sound(r, f)
            ? PyBytes_FromStringAndSize(lwb_texts(r) + f->type_length + 1,
                                        (Py_ssize_t)f->schema_length)
            : Py_NewRef(Py_None),
    };
    PyObject *item = NULL;
    if (texts[0] && texts[1] && texts[2])
        item = Py_BuildValue("OOOKK", texts[0], texts[1], texts[2],
                             (unsigned long long)f->fingerprint, (unsigned long long)f->capacity);
    for (int i = 0; i < 3; i++)
        Py_XDECREF(texts[i]);
    return item;
}

static PyObject *board_slots(Board *self, PyObject *unused)
{
    (void)unused;
    if (!is_open(self, self->path))
        return NULL;
    PyObject *list = PyList_New(0);
    struct lwb_record *r = NULL;
    int status = LWB_OK;
    self->users++; /* making objects may start the garbage collector, which may run any code */
    for (int i = 0; list; i++) {
        uint64_t offset;
        struct lwb_frame f;
        if (!(r = lwb_framed(&self->board, i, &offset, &f, &status)))
            break;
        union lwb_name name;
        uint64_t life;
        bool damaged;
        if (!lwb_name_of(r, &name, &life, &damaged) && !damaged)
            continue;
        PyObject *item = board_record(r, &f, &name, damaged);
        if (!item || PyList_Append(list, item))
            Py_CLEAR(list);
        Py_XDECREF(item);
    }
    board_leave(self);
    if (list && status != LWB_MISSING) {
        fail(status, self->path, NULL);
        Py_CLEAR(list);
    }
    return list;
}

/* find(name): returns the record of that slot as slots() does, or None. */
static PyObject *board_find(Board *self, PyObject *text)
{
    if (!is_open(self, self->path))
        return NULL;
    union lwb_name name = LWB_ZERO;
    PyObject *encoded = PyUnicode_AsEncodedString(text, "utf-8", "surrogateescape");
    Py_ssize_t length = encoded ? PyBytes_Size(encoded) : 0;
    bool possible = length > 0 && length <= LWB_MAX_NAME;
    if (possible)
        memcpy(name.text, PyBytes_AsString(encoded), (size_t)length);
    Py_XDECREF(encoded);
    if (!encoded && !PyErr_ExceptionMatches(PyExc_UnicodeEncodeError))
        return NULL;
    PyErr_Clear();
    struct lwb_record *r = NULL;
    int index, status = LWB_MISSING;
    uint64_t offset, life;
    struct lwb_frame f;
    if (possible && strlen(name.text) == (size_t)length)
        r = lwb_look_up(&self->board, &name, &index, &offset, &f, &life, &status);
    if (!r)
        return status == LWB_MISSING ? Py_NewRef(Py_None) : fail(status, self->path, NULL);
    self->users++; /* as in slots() */
    PyObject *item = board_record(r, &f, &name, false);
    board_leave(self);
    return item;
}

/* Append the name of a slot to a list, unless it has none now. Return whether that worked. */
static bool append_name(Board *self, PyObject *list, int index)
{
    union lwb_name name;
    uint64_t offset, life;
    bool damaged;
    int status;
    struct lwb_record *r = lwb_slot_at(&self->board, index, &offset, &status);
    if (!r || !lwb_name_of(r, &name, &life, &damaged))
        return true;
    PyObject *text = decoded_name(&name);
    bool done = text && !PyList_Append(list, text);
    Py_XDECREF(text);
    return done;
}

/* readings(): a number that grows when a process begins or ends to read a slot. */
static PyObject *board_readings(Board *self, PyObject *unused)
{
    (void)unused;
    return is_open(self, self->path) ? PyLong_FromUnsignedLong(lwb_readings(&self->board)) : NULL;
}

/* The names of the slots that any process reads, or of those that nobody has given up. */
static PyObject *board_names(Board *self, bool living)
{
    if (!is_open(self, self->path))
        return NULL;
    uint64_t offset;
    int status;
    self->users++; /* as in slots() */
    PyObject *list = PyList_New(0);
    struct lwb_record *r;
    for (int i = 0; list && (r = lwb_slot_at(&self->board, i, &offset, &status)); i++) {
        uint64_t life = atomic_load_explicit(&r->life, memory_order_relaxed);
        bool chosen = living ? lwb_state_of(life) != LWB_VACANT : lwb_is_read(&self->board, i);
        if (chosen && !append_name(self, list, i))
            Py_CLEAR(list);
    }
    board_leave(self);
    return list;
}

/* read(): the names of the slots that any process reads. */
static PyObject *board_read(Board *self, PyObject *unused)
{
    (void)unused;
    return board_names(self, false);
}

/* living(): the names of the slots that nobody has given up. */
static PyObject *board_living(Board *self, PyObject *unused)
{
    (void)unused;
    return board_names(self, true);
}

/* vacate(name): give up the name of a slot, if there is one. */
static PyObject *board_vacate(Board *self, PyObject *name)
{
    const char *text = PyUnicode_AsUTF8AndSize(name, NULL);
    if (!text || !is_open(self, self->path))
        return NULL;
    struct lwb_slot slot;
    const struct lwb_schema schema = {text, "", "", 0, 1};
    int status = lwb_bind(&self->board, &slot, &schema, false);
    if (status == LWB_OK || status == LWB_DIFFERS)
        lwb_vacate(&slot);
    else if (status != LWB_MISSING)
        return fail(status, name, NULL);
    Py_RETURN_NONE;
}

/* Seconds of `seconds` left since `start`; not more than 0, or NaN, if none are. */
static double seconds_left(const struct timespec *start, double seconds)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return seconds - (double)(now.tv_sec - start->tv_sec) -
           (double)(now.tv_nsec - start->tv_nsec) * 1e-9;
}

/* The nanoseconds to sleep in one go with so many seconds left. */
static uint64_t sleep_ns(double left)
{
    return !(left > 0) ? 0 : left > 1 ? 1000000000u : (uint64_t)(left * 1e9);
}

/* watch(words, timeout, readings): returns the names of the slots whose word differs from the one in
 * `words`, a bytearray, and updates it; waits for a change for at most `timeout` seconds, or until
 * readings() is another number. */
static PyObject *board_watch(Board *self, PyObject *args)
{
    PyObject *seen;
    double seconds;
    unsigned int readings;
    uint32_t which[LWB_MAX_SLOTS];
    int number = 0, status;
    if (!PyArg_ParseTuple(args, "O!dI", &PyByteArray_Type, &seen, &seconds, &readings))
        return NULL;
    struct timespec start;
    clock_gettime(CLOCK_MONOTONIC, &start);
    for (;;) {
        if (!is_open(self, self->path))
            return NULL;
        if (PyByteArray_Size(seen) != LWB_MAX_SLOTS * (Py_ssize_t)sizeof(uint64_t)) {
            PyErr_SetString(PyExc_ValueError, "watch() needs 8 bytes for each possible slot");
            return NULL;
        }
        lwb_atomic32 *watching = &lwb_head(&self->board)->watching;
        uint64_t *words = (uint64_t *)(void *)PyByteArray_AsString(seen);
        uint32_t odd = 0;
        status = lwb_changed(&self->board, words, which, &number);
        double left = seconds_left(&start, seconds);
        bool over = !(left > 0) || lwb_readings(&self->board) != readings;
        if (!status && !number && !over) {
            odd = lwb_announce(watching);
            status = lwb_changed(&self->board, words, which, &number);
            over = lwb_readings(&self->board) != readings;
        }
        if (status)
            return fail(status, self->path, NULL);
        if (number || over)
            break;
        self->users++;
        Py_BEGIN_ALLOW_THREADS
        lwb_sleep(watching, odd, sleep_ns(left));
        Py_END_ALLOW_THREADS
        board_leave(self);
        if (PyErr_CheckSignals())
            return NULL;
    }
    self->users++; /* making the list may start the garbage collector, which may run any code */
    PyObject *list = PyList_New(0);
    for (int i = 0; list && i < number; i++)
        if (!append_name(self, list, (int)which[i]))
            Py_CLEAR(list);
    board_leave(self);
    return list;
}

/* Wake all that wait for several slots of the board, in any process, to look what else is new. */
static PyObject *board_raise_alarm(Board *self, PyObject *unused)
{
    (void)unused;
    if (!self->closed)
        lwb_raise(lwb_alarm(&self->board), UINT32_MAX);
    Py_RETURN_NONE;
}

static PyMethodDef board_methods[] = {
    {"close", (PyCFunction)board_close, METH_NOARGS, NULL},
    {"linked", (PyCFunction)board_linked, METH_NOARGS, NULL},
    {"shared", (PyCFunction)board_shared, METH_NOARGS, NULL},
    {"slots", (PyCFunction)board_slots, METH_NOARGS, NULL},
    {"find", (PyCFunction)board_find, METH_O, NULL},
    {"readings", (PyCFunction)board_readings, METH_NOARGS, NULL},
    {"read", (PyCFunction)board_read, METH_NOARGS, NULL},
    {"living", (PyCFunction)board_living, METH_NOARGS, NULL},
    {"vacate", (PyCFunction)board_vacate, METH_O, NULL},
    {"raise_alarm", (PyCFunction)board_raise_alarm, METH_NOARGS, NULL},
    {"watch", (PyCFunction)board_watch, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL}};

static PyType_Slot board_type_slots[] = {
    {Py_tp_new, board_new},
    {Py_tp_dealloc, board_dealloc},
    {Py_tp_methods, board_methods},
    {0, NULL}};

static PyType_Spec board_spec = {
    .name = "llfsm.whiteboard._shm.Board",
    .basicsize = sizeof(Board),
    .flags = Py_TPFLAGS_DEFAULT,
    .slots = board_type_slots,
};
