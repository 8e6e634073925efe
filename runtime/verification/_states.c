/* The twin of _packed_states.py, which defines what is done.
 *
 * A state is some words of 64 bits, the lowest first; its highest bit is never set, so a word of
 * ones in the last place marks a free slot. Both kinds of sets are tables with open addressing, at
 * most three quarters full. Nothing but the limited API of Python 3.11 is used. */
#define PY_SSIZE_T_CLEAN
#include <Python.h>
#include <stdbool.h>
#include <stdint.h>
#include <string.h>

typedef uint64_t Word;
enum { AHEAD = 16 }; /* the states whose slots are fetched before they are looked at */
static const Word FREE = ~(Word)0;

typedef struct {
    PyObject_HEAD
    Word *at;
    Py_ssize_t size, room; /* in states */
    int words;
} States;

typedef struct {
    PyObject_HEAD
    Word *slots;
    size_t size, mask; /* the number of slots is mask + 1; none as long as `slots` is NULL */
    int words;
} Seen;

struct row {
    size_t first; /* of its effects */
    Py_ssize_t count;
    long long weight;
};

typedef struct {
    PyObject_HEAD
    Seen *keys;
    struct row *rows; /* one for each slot of `keys` */
    Word *mask;
    Word *effects; /* what an effect keeps, and what it puts there */
    size_t number, room;
    PyObject *fill;
} EffectTable;

static PyTypeObject *states_type, *seen_type, *table_type;

/* Words */

static PyObject *int_of(const Word *state, int words)
{
    if (words == 1)
        return PyLong_FromUnsignedLongLong(state[0]);
    Py_ssize_t size = (Py_ssize_t)sizeof(Word) * words;
    unsigned char bytes[size];
    for (Py_ssize_t i = 0; i < size; i++)
        bytes[i] = (unsigned char)(state[i / 8] >> 8 * (i % 8));
    return PyObject_CallMethod((PyObject *)&PyLong_Type, "from_bytes", "y#s", (char *)bytes, size,
                               "little");
}

static bool words_of(PyObject *value, Word *state, int words)
{
    if (words == 1) {
        state[0] = PyLong_AsUnsignedLongLong(value);
        return state[0] != FREE || !PyErr_Occurred();
    }
    Py_ssize_t size = (Py_ssize_t)sizeof(Word) * words;
    PyObject *bytes = PyObject_CallMethod(value, "to_bytes", "ns", size, "little");
    const char *from = bytes ? PyBytes_AsString(bytes) : NULL;
    memset(state, 0, (size_t)size);
    for (Py_ssize_t i = 0; from && i < size; i++)
        state[i / 8] |= (Word)(unsigned char)from[i] << 8 * (i % 8);
    Py_XDECREF(bytes);
    return from;
}

static inline bool is_same(const Word *one, const Word *other, int words)
{
    for (int i = 0; i < words; i++)
        if (one[i] != other[i])
            return false;
    return true;
}

/* Mix all bits, as fields are packed side by side: the finalizer of MurmurHash3. */
static inline size_t hash_of(const Word *state, int words)
{
    Word hash = 0;
    for (int i = 0; i < words; i++) {
        hash ^= state[i];
        hash ^= hash >> 33;
        hash *= 0xff51afd7ed558ccdULL;
        hash ^= hash >> 33;
        hash *= 0xc4ceb9fe1a85ec53ULL;
        hash ^= hash >> 33;
    }
    return (size_t)hash;
}

/* States */

static States *new_states(int words)
{
    States *self = PyObject_New(States, states_type);
    if (self) {
        self->at = NULL;
        self->size = self->room = 0;
        self->words = words;
    }
    return self;
}

static void drop_states(PyObject *object)
{
    PyTypeObject *type = Py_TYPE(object);
    PyMem_Free(((States *)object)->at);
    PyObject_Free(object);
    Py_DECREF(type);
}

static bool reserve(States *self, Py_ssize_t more)
{
    Py_ssize_t needed = self->size + more;
    if (needed <= self->room)
        return true;
    Py_ssize_t room = self->room + self->room / 2;
    room = room < needed ? needed : room;
    Word *at = PyMem_Realloc(self->at, (size_t)room * self->words * sizeof(Word));
    if (!at)
        return PyErr_NoMemory(), false;
    self->at = at;
    self->room = room;
    return true;
}

static PyObject *make_states(PyTypeObject *type, PyObject *arguments, PyObject *named)
{
    (void)type;
    int words;
    PyObject *values = NULL;
    static char *names[] = {"words", "states", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, named, "i|O", names, &words, &values))
        return NULL;
    if (words < 1)
        return PyErr_Format(PyExc_ValueError, "a state has a word, not %d", words);
    States *self = new_states(words);
    PyObject *each = self && values ? PyObject_GetIter(values) : NULL, *value;
    while (each && (value = PyIter_Next(each))) {
        if (reserve(self, 1) && words_of(value, self->at + self->size * words, words))
            self->size++;
        Py_DECREF(value);
        if (PyErr_Occurred())
            break;
    }
    Py_XDECREF(each);
    if (self && PyErr_Occurred()) {
        Py_DECREF(self);
        return NULL;
    }
    return (PyObject *)self;
}

static Py_ssize_t states_len(PyObject *self) { return ((States *)self)->size; }

static PyObject *states_item(PyObject *object, Py_ssize_t number)
{
    States *self = (States *)object;
    if (number < 0 || number >= self->size)
        return PyErr_Format(PyExc_IndexError, "there is no state %zd", number);
    return int_of(self->at + number * self->words, self->words);
}

static PyObject *states_slice(PyObject *object, PyObject *key)
{
    States *self = (States *)object;
    Py_ssize_t start, stop, step;
    if (!PySlice_Check(key)) {
        Py_ssize_t number = PyNumber_AsSsize_t(key, PyExc_IndexError);
        if (number == -1 && PyErr_Occurred())
            return NULL;
        return states_item(object, number < 0 ? number + self->size : number);
    }
    if (PySlice_Unpack(key, &start, &stop, &step))
        return NULL;
    Py_ssize_t size = PySlice_AdjustIndices(self->size, &start, &stop, step);
    States *part = new_states(self->words);
    if (!part || !reserve(part, size)) {
        Py_XDECREF((PyObject *)part);
        return NULL;
    }
    for (Py_ssize_t i = 0; i < size; i++)
        memcpy(part->at + i * self->words, self->at + (start + i * step) * self->words,
               sizeof(Word) * self->words);
    part->size = size;
    return (PyObject *)part;
}

static int states_contain(PyObject *object, PyObject *value)
{
    States *self = (States *)object;
    Word state[self->words];
    if (!words_of(value, state, self->words))
        return -1;
    for (Py_ssize_t i = 0; i < self->size; i++)
        if (is_same(self->at + i * self->words, state, self->words))
            return 1;
    return 0;
}

static PyType_Slot states_slots[] = {{Py_tp_new, make_states},
                                     {Py_tp_dealloc, drop_states},
                                     {Py_tp_iter, PySeqIter_New},
                                     {Py_sq_length, states_len},
                                     {Py_sq_item, states_item},
                                     {Py_sq_contains, states_contain},
                                     {Py_mp_length, states_len},
                                     {Py_mp_subscript, states_slice},
                                     {0, NULL}};
static PyType_Spec states_spec = {"llfsm.runtime.verification._states.States", sizeof(States), 0,
                                  Py_TPFLAGS_DEFAULT, states_slots};

/* Seen: a set of states */

static Seen *new_seen(int words)
{
    Seen *self = PyObject_New(Seen, seen_type);
    if (self) {
        self->slots = NULL;
        self->size = self->mask = 0;
        self->words = words;
    }
    return self;
}

static void drop_seen(PyObject *object)
{
    PyTypeObject *type = Py_TYPE(object);
    PyMem_Free(((Seen *)object)->slots);
    PyObject_Free(object);
    Py_DECREF(type);
}

static PyObject *make_seen(PyTypeObject *type, PyObject *arguments, PyObject *named)
{
    (void)type;
    int words;
    static char *names[] = {"words", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, named, "i", names, &words))
        return NULL;
    if (words < 1)
        return PyErr_Format(PyExc_ValueError, "a state has a word, not %d", words);
    return (PyObject *)new_seen(words);
}

/* Find the slot of a state, or the free one for it. There must be slots. */
static inline size_t slot_of(const Seen *self, const Word *state, int words, size_t hash)
{
    size_t slot = hash & self->mask;
    for (;; slot = (slot + 1) & self->mask) {
        const Word *there = self->slots + slot * words;
        if (there[words - 1] == FREE || is_same(there, state, words))
            return slot;
    }
}

/* Make twice the slots if they are three quarters full; move `rows`, if any, too. */
static bool grow(Seen *self, struct row **rows)
{
    size_t number = self->slots ? self->mask + 1 : 0, doubled = number ? 2 * number : 8;
    if (4 * (self->size + 1) <= 3 * number)
        return true;
    size_t bytes = doubled * self->words * sizeof(Word);
    Seen larger = {.slots = PyMem_Malloc(bytes), .mask = doubled - 1, .words = self->words};
    struct row *moved = rows ? PyMem_Malloc(doubled * sizeof(struct row)) : NULL;
    if (!larger.slots || (rows && !moved)) {
        PyMem_Free(larger.slots);
        PyMem_Free(moved);
        return PyErr_NoMemory(), false;
    }
    memset(larger.slots, 0xff, bytes);
    for (size_t i = 0; i < number; i++) {
        const Word *state = self->slots + i * self->words;
        if (state[self->words - 1] == FREE)
            continue;
        size_t slot = slot_of(&larger, state, self->words, hash_of(state, self->words));
        memcpy(larger.slots + slot * self->words, state, sizeof(Word) * self->words);
        if (rows)
            moved[slot] = (*rows)[i];
    }
    PyMem_Free(self->slots);
    self->slots = larger.slots;
    self->mask = larger.mask;
    if (rows) {
        PyMem_Free(*rows);
        *rows = moved;
    }
    return true;
}

static inline bool add_states(Seen *self, const States *states, States *found, int words)
{
    Py_ssize_t size = states->size;
    size_t hashes[AHEAD];
    for (Py_ssize_t i = 0; i < size + AHEAD; i++) {
        /* Most slots are not in the cache: begin to fetch each before it is needed. */
        Py_ssize_t number = i - AHEAD;
        size_t hash = hashes[i % AHEAD];
        if (i < size) {
            hashes[i % AHEAD] = hash_of(states->at + i * words, words);
            if (self->slots)
                __builtin_prefetch(self->slots + (hashes[i % AHEAD] & self->mask) * words, 1);
        }
        if (number < 0 || number >= size)
            continue;
        const Word *state = states->at + number * words;
        if (!grow(self, NULL) || !reserve(found, 1))
            return false;
        Word *slot = self->slots + slot_of(self, state, words, hash) * words;
        if (slot[words - 1] != FREE)
            continue;
        memcpy(slot, state, sizeof(Word) * words);
        self->size++;
        memcpy(found->at + found->size++ * words, state, sizeof(Word) * words);
    }
    return true;
}

static bool are_states(PyObject *object, int words)
{
    if (Py_IS_TYPE(object, states_type) && ((States *)object)->words == words)
        return true;
    PyErr_Format(PyExc_TypeError, "states of %d words are expected, not %R", words, object);
    return false;
}

static PyObject *seen_add(PyObject *object, PyObject *arguments)
{
    Seen *self = (Seen *)object;
    PyObject *states, *found;
    if (!PyArg_ParseTuple(arguments, "OO", &states, &found) || !are_states(states, self->words) ||
        !are_states(found, self->words))
        return NULL;
    if (states == found)
        return PyErr_Format(PyExc_ValueError, "states cannot be added to themselves");
    bool done = self->words == 1
                    ? add_states(self, (States *)states, (States *)found, 1)
                    : add_states(self, (States *)states, (States *)found, self->words);
    if (!done)
        return NULL;
    Py_RETURN_NONE;
}

static Py_ssize_t seen_len(PyObject *self) { return (Py_ssize_t)((Seen *)self)->size; }

static PyMethodDef seen_methods[] = {{"add", seen_add, METH_VARARGS, NULL}, {NULL, NULL, 0, NULL}};
static PyType_Slot seen_slots[] = {{Py_tp_new, make_seen},
                                   {Py_tp_dealloc, drop_seen},
                                   {Py_tp_methods, seen_methods},
                                   {Py_sq_length, seen_len},
                                   {0, NULL}};
static PyType_Spec seen_spec = {"llfsm.runtime.verification._states.Seen", sizeof(Seen), 0,
                                Py_TPFLAGS_DEFAULT, seen_slots};

/* EffectTable */

static int visit_table(PyObject *object, visitproc visit, void *arg)
{
    Py_VISIT(Py_TYPE(object));
    Py_VISIT(((EffectTable *)object)->fill);
    return 0;
}

static int clear_table(PyObject *object)
{
    Py_CLEAR(((EffectTable *)object)->fill);
    return 0;
}

static void drop_table(PyObject *object)
{
    EffectTable *self = (EffectTable *)object;
    PyTypeObject *type = Py_TYPE(object);
    PyObject_GC_UnTrack(object);
    clear_table(object);
    Py_XDECREF((PyObject *)self->keys);
    PyMem_Free(self->rows);
    PyMem_Free(self->mask);
    PyMem_Free(self->effects);
    freefunc release = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release(object);
    Py_DECREF(type);
}

static PyObject *make_table(PyTypeObject *type, PyObject *arguments, PyObject *named)
{
    int words;
    PyObject *mask, *fill;
    static char *names[] = {"words", "mask", "fill", NULL};
    if (!PyArg_ParseTupleAndKeywords(arguments, named, "iOO", names, &words, &mask, &fill))
        return NULL;
    if (words < 1)
        return PyErr_Format(PyExc_ValueError, "a state has a word, not %d", words);
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    EffectTable *self = (EffectTable *)allocate(type, 0); /* all its fields are 0 */
    if (!self)
        return NULL;
    self->fill = Py_NewRef(fill);
    self->keys = new_seen(words);
    self->mask = PyMem_Malloc(sizeof(Word) * words);
    if (!self->mask)
        PyErr_NoMemory();
    if (!self->keys || !self->mask || !words_of(mask, self->mask, words)) {
        Py_DECREF(self);
        return NULL;
    }
    return (PyObject *)self;
}

/* Keep an effect, which is a pair of what to keep and what to put there. */
static bool add_effect(EffectTable *self, PyObject *effect)
{
    int words = self->keys->words;
    PyObject *keep, *put;
    if (self->number == self->room) {
        size_t room = self->room ? 2 * self->room : 4;
        Word *effects = PyMem_Realloc(self->effects, room * 2 * words * sizeof(Word));
        if (!effects)
            return PyErr_NoMemory(), false;
        self->effects = effects;
        self->room = room;
    }
    Word *at = self->effects + self->number * 2 * words;
    if (!PyArg_ParseTuple(effect, "OO", &keep, &put) || !words_of(keep, at, words) ||
        !words_of(put, at + words, words))
        return false;
    self->number++;
    return true;
}

/* Ask for the effects that belong to a key, and keep them. */
static bool fill_row(EffectTable *self, const Word *key)
{
    int words = self->keys->words;
    PyObject *asked = int_of(key, words), *effects;
    PyObject *answer = asked ? PyObject_CallFunctionObjArgs(self->fill, asked, NULL) : NULL;
    struct row row = {.first = self->number};
    bool done = answer && PyArg_ParseTuple(answer, "LO!", &row.weight, &PyTuple_Type, &effects);
    if (done) {
        row.count = PyTuple_Size(effects);
        for (Py_ssize_t i = 0; done && i < row.count; i++)
            done = add_effect(self, PyTuple_GetItem(effects, i));
        if (!done)
            self->number = row.first;
    }
    Py_XDECREF(asked);
    Py_XDECREF(answer);
    if (!done || !grow(self->keys, &self->rows))
        return false;
    size_t slot = slot_of(self->keys, key, words, hash_of(key, words));
    if (self->keys->slots[slot * words + words - 1] == FREE) {
        memcpy(self->keys->slots + slot * words, key, sizeof(Word) * words);
        self->keys->size++;
        self->rows[slot] = row;
    }
    return true;
}

/* Find the effects of a state; NULL with an exception if they cannot be found. */
static inline const struct row *row_of(EffectTable *self, const Word *state, int words)
{
    Word key[words];
    for (int i = 0; i < words; i++)
        key[i] = state[i] & self->mask[i];
    for (bool again = false;; again = true) {
        if (self->keys->slots) {
            size_t slot = slot_of(self->keys, key, words, hash_of(key, words));
            if (self->keys->slots[slot * words + words - 1] != FREE)
                return self->rows + slot;
        }
        if (again || !fill_row(self, key))
            return NULL;
    }
}

static inline bool apply(EffectTable *self, const States *states, States *after,
                         long long *weight, int words)
{
    for (Py_ssize_t i = 0; i < states->size; i++) {
        const Word *state = states->at + i * words;
        const struct row *row = row_of(self, state, words);
        if (!row || !reserve(after, row->count))
            return false;
        *weight += row->weight;
        const Word *effect = self->effects + row->first * 2 * words;
        Word *to = after->at + after->size * words;
        for (Py_ssize_t n = 0; n < row->count; n++, effect += 2 * words, to += words)
            for (int k = 0; k < words; k++)
                to[k] = (state[k] & effect[k]) | effect[words + k];
        after->size += row->count;
    }
    return true;
}

static PyObject *table_apply(PyObject *object, PyObject *states)
{
    EffectTable *self = (EffectTable *)object;
    int words = self->keys->words;
    States *after = are_states(states, words) ? new_states(words) : NULL;
    long long weight = 0;
    if (!after)
        return NULL;
    if (words == 1 ? apply(self, (States *)states, after, &weight, 1)
                   : apply(self, (States *)states, after, &weight, words))
        return Py_BuildValue("NL", after, weight);
    Py_DECREF(after);
    return NULL;
}

static PyObject *table_split(PyObject *object, PyObject *argument)
{
    EffectTable *self = (EffectTable *)object;
    int words = self->keys->words;
    if (!are_states(argument, words))
        return NULL;
    States *states = (States *)argument, *parts[2] = {new_states(words), new_states(words)};
    bool done = parts[0] && parts[1];
    for (Py_ssize_t i = 0; done && i < states->size; i++) {
        const Word *state = states->at + i * words;
        const struct row *row = row_of(self, state, words);
        States *part = row ? parts[row->count == 0] : NULL;
        done = part && reserve(part, 1);
        if (done)
            memcpy(part->at + part->size++ * words, state, sizeof(Word) * words);
    }
    if (done)
        return Py_BuildValue("NN", parts[0], parts[1]);
    Py_XDECREF((PyObject *)parts[0]);
    Py_XDECREF((PyObject *)parts[1]);
    return NULL;
}

static PyObject *table_effects(PyObject *object, PyObject *value)
{
    EffectTable *self = (EffectTable *)object;
    int words = self->keys->words;
    Word state[words];
    const struct row *row = words_of(value, state, words) ? row_of(self, state, words) : NULL;
    PyObject *effects = row ? PyTuple_New(row->count) : NULL;
    for (Py_ssize_t i = 0; effects && i < row->count; i++) {
        const Word *effect = self->effects + (row->first + i) * 2 * words;
        PyObject *pair = Py_BuildValue("NN", int_of(effect, words), int_of(effect + words, words));
        if (pair)
            PyTuple_SetItem(effects, i, pair);
        else
            Py_CLEAR(effects);
    }
    return effects;
}

static PyMethodDef table_methods[] = {{"apply", table_apply, METH_O, NULL},
                                      {"split", table_split, METH_O, NULL},
                                      {"effects", table_effects, METH_O, NULL},
                                      {NULL, NULL, 0, NULL}};
static PyType_Slot table_slots[] = {{Py_tp_new, make_table},
                                    {Py_tp_dealloc, drop_table},
                                    {Py_tp_traverse, visit_table},
                                    {Py_tp_clear, clear_table},
                                    {Py_tp_methods, table_methods},
                                    {0, NULL}};
static PyType_Spec table_spec = {"llfsm.runtime.verification._states.EffectTable",
                                 sizeof(EffectTable), 0,
                                 Py_TPFLAGS_DEFAULT | Py_TPFLAGS_HAVE_GC, table_slots};

static struct PyModuleDef definition = {PyModuleDef_HEAD_INIT, .m_name = "_states", .m_size = -1};

static bool add_type(PyObject *module, PyTypeObject **type, PyType_Spec *spec)
{
    *type = (PyTypeObject *)PyType_FromSpec(spec);
    return *type && !PyModule_AddType(module, *type);
}

PyMODINIT_FUNC PyInit__states(void)
{
    PyObject *module = PyModule_Create(&definition);
    if (!module || !add_type(module, &states_type, &states_spec) ||
        !add_type(module, &seen_type, &seen_spec) || !add_type(module, &table_type, &table_spec))
        Py_CLEAR(module);
    return module;
}
