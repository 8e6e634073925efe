/* A fast check that a message's fields have the types that its class declares. Each add checks
 * them, because a wrong value would fail in every reader, in other processes. The decoder is the
 * authority but costs more than the add; this check recognises obviously valid messages by a few
 * comparisons: msgspec keeps a Struct's fields at fixed offsets, given by member descriptors. */
#include <Python.h>
#include <structmember.h>

enum field_kind { FIELD_FLOAT, FIELD_INT, FIELD_BOOL, FIELD_STR, FIELD_BYTES, FIELD_MESSAGE,
                  FIELD_OTHER /* left to the decoder */ };

struct field_check;
struct field_checks {
    Py_ssize_t count;
    struct field_check *at;
};
struct field_check {
    Py_ssize_t place;
    int kind;
    long long least, most;       /* FIELD_INT: the range */
    PyTypeObject *type;          /* FIELD_MESSAGE: borrowed from the outer class's schema */
    struct field_checks inner;
};

static inline void field_checks_free(struct field_checks *checks)
{
    for (Py_ssize_t i = 0; i < checks->count; i++)
        field_checks_free(&checks->at[i].inner);
    PyMem_Free(checks->at);
    *checks = (struct field_checks){0, NULL};
}

/* `fields`: a tuple of (name, kind, least, most, message type or None, its fields). Returns
 * 0, or -1 with an exception. */
static inline int field_checks_init(struct field_checks *checks, PyTypeObject *type,
                                    PyObject *fields)
{
    Py_ssize_t count = PyTuple_GET_SIZE(fields);
    checks->at = PyMem_Calloc((size_t)count + 1, sizeof *checks->at);
    if (!checks->at) {
        PyErr_NoMemory();
        return -1;
    }
    for (Py_ssize_t i = 0; i < count; i++) {
        struct field_check *c = &checks->at[i];
        PyObject *inner_type, *inner;
        const char *name;
        if (!PyArg_ParseTuple(PyTuple_GET_ITEM(fields, i), "siLLOO!", &name, &c->kind, &c->least,
                              &c->most, &inner_type, &PyTuple_Type, &inner))
            goto failed;
        PyObject *member = PyObject_GetAttrString((PyObject *)type, name);
        if (!member)
            goto failed;
        if (!Py_IS_TYPE(member, &PyMemberDescr_Type)) {
            Py_DECREF(member);
            PyErr_Format(PyExc_TypeError, "%s.%s is not a field", type->tp_name, name);
            goto failed;
        }
        c->place = ((PyMemberDescrObject *)member)->d_member->offset;
        Py_DECREF(member);
        c->type = (PyTypeObject *)inner_type;
        checks->count = i + 1;
        if (c->kind == FIELD_MESSAGE && field_checks_init(&c->inner, c->type, inner))
            goto failed;
    }
    return 0;
failed:
    field_checks_free(checks);
    return -1;
}

static inline int field_checks_hold(const struct field_checks *checks, PyObject *message)
{
    for (Py_ssize_t i = 0; i < checks->count; i++) {
        const struct field_check *c = &checks->at[i];
        PyObject *value = *(PyObject **)((char *)message + c->place);
        if (!value)
            return 0;
        int right = 0;
        switch (c->kind) {
        case FIELD_FLOAT: /* the decoder accepts an int as a float, too */
            right = PyFloat_CheckExact(value) || PyLong_CheckExact(value);
            break;
        case FIELD_INT: {
            int overflow;
            if (!PyLong_CheckExact(value))
                break;
            long long number = PyLong_AsLongLongAndOverflow(value, &overflow);
            right = !overflow && number >= c->least && number <= c->most;
            break;
        }
        case FIELD_BOOL: right = PyBool_Check(value); break;
        case FIELD_STR: right = PyUnicode_CheckExact(value); break;
        case FIELD_BYTES: right = PyBytes_CheckExact(value); break;
        case FIELD_MESSAGE:
            right = Py_IS_TYPE(value, c->type) && field_checks_hold(&c->inner, value);
            break;
        }
        if (!right)
            return 0;
    }
    return 1;
}
