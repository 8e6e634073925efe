/* The C part of seats, states and the like: what every turn uses of them, in fields of a structure.
 * The Python classes extend it, and see the fields as attributes. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stddef.h>
#include <structmember.h>

/* One structure for all: the garbage collector needs to know only one. */
typedef struct {
    PyObject_HEAD
    union {
        struct { /* of a seat */
            PyObject *machine, *request, *sensors, *current, *previous, *source, *suspension,
                *notifies, *now, *entered_ns, *meter, *timed, *failure, *hang, *inner, *children;
        };
        struct { /* of a state of a loaded machine */
            PyObject *on_entry, *on_exit, *internal, *on_suspend, *on_resume, *transitions;
        };
        struct { /* of a rotation */
            PyObject *_turn, *_leaving, *stopwatch, *_gate, *nests;
        };
        struct { /* of a meter */
            PyObject *costs, *jitters;
        };
        PyObject *fields[16];
    };
    union {
        const struct ringlet *running; /* in a seat; NULL if none is */
        long long spent_ns;            /* in a state */
        long long rounds;              /* of a rotation */
        struct {                       /* of a meter */
            long long fired, overruns, worst_overrun_ns, since_ns, late_ns;
        };
        struct { /* of a timing, whose clock is `now` */
            long long begin_ns, due_ns, deadline_ns;
        };
    };
} Record;

#define FIELD(name) {#name, T_OBJECT_EX, offsetof(Record, name), 0, NULL}
#define NUMBER(name) {#name, T_LONGLONG, offsetof(Record, name), 0, NULL}

static PyMemberDef seat_fields[] = {
    FIELD(machine), FIELD(request),    FIELD(sensors),  FIELD(current), FIELD(previous),
    FIELD(source),  FIELD(suspension), FIELD(notifies), FIELD(now),     FIELD(entered_ns),
    FIELD(meter),   FIELD(timed),      FIELD(failure),  FIELD(hang),    FIELD(inner),
    FIELD(children), {NULL, 0, 0, 0, NULL}};

static PyMemberDef state_fields[] = {
    FIELD(on_entry),   FIELD(on_exit),   FIELD(internal),
    FIELD(on_suspend), FIELD(on_resume), FIELD(transitions),
    NUMBER(spent_ns),  {NULL, 0, 0, 0, NULL}};

static PyMemberDef rotation_fields[] = {
    FIELD(_turn), FIELD(_leaving), FIELD(stopwatch),       FIELD(_gate),
    FIELD(nests), NUMBER(rounds),  {NULL, 0, 0, 0, NULL}};

/* A class of records, and the class in Python that extends it: nearly all records are of that. */
struct kind {
    const char *name;
    PyMemberDef *fields;
    PyMethodDef *methods;
    PyTypeObject *type;
    PyObject *latest;
};

static PyMethodDef no_methods[] = {{NULL, NULL, 0, NULL}};
static struct kind seats = {.name = "llfsm.runtime.engine._ringlet.SeatFields",
                            .fields = seat_fields,
                            .methods = no_methods};
static struct kind states = {.name = "llfsm.runtime.engine._ringlet.StateFields",
                             .fields = state_fields,
                             .methods = no_methods};

/* Return a new reference to a field's value; NULL with an error if it was deleted. */
static void *hold(void *value)
{
    if (!value)
        PyErr_SetString(PyExc_AttributeError, "a field of a seat, state or the like is missing");
    return Py_XNewRef((PyObject *)value);
}

static void put(PyObject **field, void *value)
{
    PyObject *before = *field;
    *field = Py_NewRef((PyObject *)value);
    Py_XDECREF(before);
}

static bool extends(PyTypeObject *type, struct kind *kind)
{
    bool yes = PyType_IsSubtype(type, kind->type);
    if (yes)
        put(&kind->latest, type); /* held: no other type may come to lie in its place */
    return yes;
}

static inline bool is_one_of(struct kind *kind, void *object)
{
    PyTypeObject *type = Py_TYPE((PyObject *)object);
    return (PyObject *)type == kind->latest || extends(type, kind);
}

static int record_traverse(PyObject *self, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE(self));
    for (size_t i = 0; i < sizeof((Record *)0)->fields / sizeof(PyObject *); i++)
        Py_VISIT(((Record *)self)->fields[i]);
    return 0;
}

static int record_clear(PyObject *self)
{
    for (size_t i = 0; i < sizeof((Record *)0)->fields / sizeof(PyObject *); i++)
        Py_CLEAR(((Record *)self)->fields[i]);
    return 0;
}

static void record_dealloc(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    PyObject_GC_UnTrack(self);
    record_clear(self);
    ((freefunc)PyType_GetSlot(type, Py_tp_free))(self);
    Py_DECREF((PyObject *)type);
}

/* Make the type of a kind of records and add it to the module. */
static bool add_type(PyObject *module, struct kind *kind)
{
    PyType_Slot slots[] = {{Py_tp_members, kind->fields},
                           {Py_tp_methods, kind->methods},
                           {Py_tp_traverse, record_traverse},
                           {Py_tp_clear, record_clear},
                           {Py_tp_dealloc, record_dealloc},
                           {0, NULL}};
    PyType_Spec spec = {kind->name, sizeof(Record), 0,
                        Py_TPFLAGS_DEFAULT | Py_TPFLAGS_BASETYPE | Py_TPFLAGS_HAVE_GC, slots};
    kind->type = (PyTypeObject *)PyType_FromSpec(&spec);
    return kind->type && !PyModule_AddType(module, kind->type);
}
