/* A fast check that a message's fields have the types that its class declares. Each add checks
 * them, because a wrong value would fail in every reader, in other processes. The decoder is the
 * authority but costs more than the add; this check recognises obviously valid messages by a few
 * comparisons: msgspec keeps a Struct's fields at fixed places of the object. */
#include <Python.h>

enum field_kind { FIELD_FLOAT, FIELD_INT, FIELD_BOOL, FIELD_STR, FIELD_BYTES, FIELD_MESSAGE,
                  FIELD_TUPLE, FIELD_OTHER /* left to the decoder */ };

struct field_check;
struct field_checks {
    Py_ssize_t count;
    struct field_check *at;
};
struct field_check {
    Py_ssize_t place;
    int kind;
    long long least, most;       /* FIELD_INT: the range; FIELD_TUPLE: how many items */
    PyTypeObject *type;          /* FIELD_MESSAGE: borrowed from the outer class's schema */
    struct field_checks inner;   /* FIELD_TUPLE: one, for each of its items */
};

static inline void field_checks_free(struct field_checks *checks)
{
    for (Py_ssize_t i = 0; i < checks->count; i++)
        field_checks_free(&checks->at[i].inner);
    PyMem_Free(checks->at);
    *checks = (struct field_checks){0, NULL};
}

/* Return the offset at which instances of a type keep a field, or -1 with an exception. The limited
 * API does not tell it, so we set the field of an `empty` instance to a new object, past the type's
 * own refusal to change, and look where its address appears. */
static inline Py_ssize_t field_place(PyObject *empty, const char *name)
{
    PyObject *size = PyObject_GetAttrString((PyObject *)Py_TYPE(empty), "__basicsize__");
    PyObject *text = PyUnicode_FromString(name), *mark = PyList_New(0);
    Py_ssize_t place = -1, end = size ? PyLong_AsSsize_t(size) : -1;
    if (end >= 0 && text && mark && !PyObject_GenericSetAttr(empty, text, mark)) {
        place = sizeof *empty;
        while (place < end && *(PyObject **)((char *)empty + place) != mark)
            place += sizeof mark;
        if (place >= end) {
            PyErr_Format(PyExc_TypeError, "%R keeps no field %s", Py_TYPE(empty), name);
            place = -1;
        }
    }
    Py_XDECREF(size);
    Py_XDECREF(text);
    Py_XDECREF(mark);
    return place;
}

/* `fields`: a tuple of (name, kind, least, most, message type or None, its fields); `type` is NULL
 * for the item of a tuple, which has no place. Returns 0, or -1 with an exception. */
static inline int field_checks_init(struct field_checks *checks, PyTypeObject *type,
                                    PyObject *fields)
{
    Py_ssize_t count = PyTuple_Size(fields);
    checks->at = PyMem_Calloc((size_t)count + 1, sizeof *checks->at);
    if (!checks->at) {
        PyErr_NoMemory();
        return -1;
    }
    PyObject *empty = type ? PyType_GenericAlloc(type, 0) : NULL;
    if (type && !empty)
        goto failed;
    for (Py_ssize_t i = 0; i < count; i++) {
        struct field_check *c = &checks->at[i];
        PyObject *inner_type, *inner;
        const char *name;
        if (!PyArg_ParseTuple(PyTuple_GetItem(fields, i), "siLLOO!", &name, &c->kind, &c->least,
                              &c->most, &inner_type, &PyTuple_Type, &inner))
            goto failed;
        if (empty && (c->place = field_place(empty, name)) < 0)
            goto failed;
        c->type = (PyTypeObject *)inner_type;
        checks->count = i + 1;
        if ((c->kind == FIELD_MESSAGE && field_checks_init(&c->inner, c->type, inner)) ||
            (c->kind == FIELD_TUPLE && field_checks_init(&c->inner, NULL, inner)))
            goto failed;
    }
    Py_XDECREF(empty);
    return 0;
failed:
    Py_XDECREF(empty);
    field_checks_free(checks);
    return -1;
}

static inline int field_checks_hold(const struct field_checks *checks, PyObject *message);

static inline int field_holds(const struct field_check *c, PyObject *value)
{
    switch (c->kind) {
    case FIELD_FLOAT: /* the decoder accepts an int as a float, too */
        return PyFloat_CheckExact(value) || PyLong_CheckExact(value);
    case FIELD_INT: {
        if (!PyLong_CheckExact(value))
            return 0;
        int overflow;
        long long number = PyLong_AsLongLongAndOverflow(value, &overflow);
        return !overflow && number >= c->least && number <= c->most;
    }
    case FIELD_BOOL: return PyBool_Check(value);
    case FIELD_STR: return PyUnicode_CheckExact(value);
    case FIELD_BYTES: return PyBytes_CheckExact(value);
    case FIELD_MESSAGE: return Py_IS_TYPE(value, c->type) && field_checks_hold(&c->inner, value);
    case FIELD_TUPLE: {
        Py_ssize_t count = PyTuple_CheckExact(value) ? PyTuple_Size(value) : -1;
        if (count < c->least || count > c->most)
            return 0;
        for (Py_ssize_t i = 0; i < count; i++)
            if (!field_holds(c->inner.at, PyTuple_GetItem(value, i)))
                return 0;
        return 1;
    }
    }
    return 0;
}

static inline int field_checks_hold(const struct field_checks *checks, PyObject *message)
{
    for (Py_ssize_t i = 0; i < checks->count; i++) {
        const struct field_check *c = &checks->at[i];
        PyObject *value = *(PyObject **)((char *)message + c->place);
        if (!value || !field_holds(c, value))
            return 0;
    }
    return 1;
}
