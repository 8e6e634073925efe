//
// State_Done.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class Done: public CLState
            {
                CLTransition *_transitions[0];

                public:
                    Done(const char *name = "Done");

                    virtual int numberOfTransitions() const { return 0; }

#                   include "State_Done_Variables.h"
            };
