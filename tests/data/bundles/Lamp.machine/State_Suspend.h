//
// State_Suspend.h
//
// Automatically created through MiCASE -- do not change manually!
//
            class Suspend: public CLState
            {
                CLTransition *_transitions[0];

                public:
                    Suspend(const char *name = "Suspend");

                    virtual int numberOfTransitions() const { return 0; }

#                   include "State_Suspend_Variables.h"
            };
